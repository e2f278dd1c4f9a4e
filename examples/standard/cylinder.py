"""A round rod, to be bent."""

import fields as sdf

shape = sdf.cylinder(0.4, 4.0)
