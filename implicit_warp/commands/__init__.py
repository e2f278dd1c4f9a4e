"""The commands of `implicit-warp`, one a module; `implicit_warp.cli` runs them.

They import what they need when they run, so that `--help` is quick.
"""
