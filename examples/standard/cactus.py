"""A cactus with two arms, one of them to be bent."""

import fields as sdf

trunk = sdf.capsule((0, 0, -1.8), (0, 0, 1.8), 0.42)
high_arm = sdf.union(
    sdf.capsule((0, 0, 0.0), (1.15, 0, 0.0), 0.26),
    sdf.capsule((1.15, 0, 0.0), (1.15, 0, 1.3), 0.26),
    smooth=0.1,
)
low_arm = sdf.union(
    sdf.capsule((0, 0, -0.6), (-1.0, 0, -0.6), 0.24),
    sdf.capsule((-1.0, 0, -0.6), (-1.0, 0, 0.5), 0.24),
    smooth=0.1,
)
pot = sdf.cylinder(0.9, 0.5).translate((0, 0, -1.9))

shape = sdf.union(trunk, high_arm, low_arm, smooth=0.25) | pot
