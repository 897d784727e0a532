"""From a problem to per-agent controllers with a certified lower bound on the satisfaction probability."""

if __name__ == "synthesis":
    raise ImportError("import `certigym.synthesis`, not `synthesis`: this folder is a part of the package certigym")
