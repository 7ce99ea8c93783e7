"""The generator of odd films is a package that a benchmark uses too: it is found next to this folder."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))
