"""The command line: one module for each tool, `main` to choose between them."""
