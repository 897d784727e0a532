"""The ids of the suite and the modules behind them (a table alone, so that registering loads no problem)."""

NAMESPACE = "certigym"

MODULES = {
    "invariance-20-v0": "invariance_20_v0",
    "invariance-4-v0": "invariance_4_v0",
    "invariance-v0": "invariance_v0",
    "package-delivery-eased-v0": "package_delivery_eased_v0",
    "package-delivery-v0": "package_delivery_v0",
    "reach-avoid-n-v0": "reach_avoid_n_v0",
    "reach-avoid-v0": "reach_avoid_v0",
}
