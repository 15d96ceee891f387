"""``python -m taichi_cloth.benchmarks.accuracy``."""

import sys

from taichi_cloth.benchmarks.accuracy.command import main

if __name__ == "__main__":
    sys.exit(main())
