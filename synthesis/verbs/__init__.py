"""The verbs, a file each: synthesize, certify, check.

The verbs, a file each: `synthesize`, `certify`, `improve`, `check`, and bounds from above.
"""
