"""Monte Carlo rollouts of the continuous system and the verdict on a certificate."""

if __name__ == "validation":
    raise ImportError("import `certigym.validation`, not `validation`: this folder is a part of the package certigym")
