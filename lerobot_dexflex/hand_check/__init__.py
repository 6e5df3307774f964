"""Check the numbers of a hand before anything is trained or recorded with it: `dexflex-hand check`."""
