"""A connecting rod: two bored eyes, a filleted shank with a slot, and a rib on either side."""

import fields as sdf

eyes = sdf.cylinder(0.8, 0.7).translate((-1.6, 0, 0)) | sdf.cylinder(0.6, 0.7).translate((1.6, 0, 0))
shank = sdf.rounded_box((3.0, 0.75, 0.4), 0.08)
ribs = sdf.rounded_box((2.6, 0.14, 0.62), 0.05)
slot = sdf.capsule((-0.45, 0.0, 0.0), (0.45, 0.0, 0.0), 0.2)

shape = sdf.union(eyes, shank, ribs - slot.offset(0.1), smooth=0.12)
shape -= sdf.cylinder(0.48).translate((-1.6, 0, 0)) | sdf.cylinder(0.34).translate((1.6, 0, 0))
shape -= slot | sdf.box((0.9, 0.4, 2.0)) | sdf.cylinder(0.2).translate((0.45, 0, 0))
shape -= sdf.cylinder(0.2).translate((-0.45, 0, 0))
