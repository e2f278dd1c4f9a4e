"""Two-dimensional shapes, as fields that do not depend on z.

A profile is the infinite prism above a shape of the x-y plane. Its distance in the plane is its
distance in space, so booleans, motions that keep z, offsets and all tags are those of any other
field; `Field.is_profile` tells whether a field is one, and `fields.solids` and `fields.sweeps` make
solids of them. Half-planes are `left`, `right`, `front` and `behind`.

Everything with straight sides is one thing: edges in order, inside on the left (`edges`), whose
exact distance is arithmetic for few of them and a compiled search for many (`outline`). Curves
(`curves`), glyphs (`lettering`), drawings (`drawing`) and pictures (`picture`) become such edges.
"""
