"""The lowest versions that pyproject.toml allows, as pip's constraints: `pip install -c FILE`."""

import re
from pathlib import Path

SETTINGS = Path(__file__).parents[1] / "pyproject.toml"

_, _, project = SETTINGS.read_text().partition("[project]")  # not what builds it
for name, version in re.findall(r'"([\w-]+)(?:\[\w+\])?>=([\d.]+)', project):
    print(f"{name}=={version}")
