"""A connecting rod: two bored eyes, a shank with a slot, and a rib on either side."""

import fields as sdf

eyes = sdf.cylinder(0.74, 0.58).translate((-1.6, 0, 0)) | sdf.cylinder(0.54, 0.58).translate(
    (1.6, 0, 0)
)
shank = sdf.rounded_box((3.0, 0.75, 0.36), 0.1)
rib = sdf.rounded_box((2.6, 0.16, 0.6), 0.07)
bores = sdf.cylinder(0.44).translate((-1.6, 0, 0)) | sdf.cylinder(0.3).translate((1.6, 0, 0))
slot = sdf.box((0.9, 0.38, 2.0)) | sdf.cylinder(0.19).translate((-0.45, 0, 0))
slot |= sdf.cylinder(0.19).translate((0.45, 0, 0))

# Growing the eyes rounds their edges; smooth operations leave fillets where parts meet.
shape = sdf.union(eyes.offset(0.06), shank, rib, smooth=0.14)
shape = shape.difference(bores, slot, smooth=0.06)
