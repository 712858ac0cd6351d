"""USD: a stage of the asset, written as .usda, .usdc or .usdz. `pxr` is imported only inside functions."""
