import sys
from pathlib import Path

# Tests import the synthetic hand by name.
sys.path.insert(0, str(Path(__file__).parent))
