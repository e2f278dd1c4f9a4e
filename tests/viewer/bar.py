"""A bar to edit, and a quick solve of its handles."""

BAR = "import fields as sdf\nshape = sdf.box((0.4, 0.4, 2.0))\n"

BAR_HANDLES = """
[[handle]]
region = "below(-0.7)"
hold = true

[[handle]]
region = "above(0.7)"
translate = [0.3, 0, 0]

[solve]
layers = 6
resolution = 5
steps = 50
samples = 256
handle_samples = 64
"""
