"""The lowest versions that pyproject.toml allows, as pip's constraints: `pip install -c FILE`."""

import re
from pathlib import Path

SETTINGS = Path(__file__).parents[1] / "pyproject.toml"

for name, version in re.findall(r'"([\w-]+)(?:\[\w+\])?>=([\d.]+)', SETTINGS.read_text()):
    print(f"{name}=={version}")
