"""A square bar, to be twisted."""

import fields as sdf

shape = sdf.box((1.0, 1.0, 4.0))
