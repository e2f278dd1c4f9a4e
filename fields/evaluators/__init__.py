"""Evaluators of expressions besides torch: compiled values and gradients, bounds, shaders."""
