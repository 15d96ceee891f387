"""``python -m taichi_cloth``: the same as the command ``taichi-cloth``."""

import sys

from taichi_cloth.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
