"""A square plate, to be lifted in the middle."""

import fields as sdf

shape = sdf.box((4.0, 4.0, 0.2))
