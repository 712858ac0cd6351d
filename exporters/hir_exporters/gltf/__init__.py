"""glTF 2.0: gather an asset into a typed document, then bytes. One extension per file."""
