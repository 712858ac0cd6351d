"""USD: an asset as a stage, then .usda, .usdc or a .usdz package. pxr is imported only inside functions."""
