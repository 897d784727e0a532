"""The verbs, a file each: `synthesize`, `certify`, `improve`, `check`, and bounds from above."""
