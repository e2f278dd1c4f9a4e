"""Signed distances as small neural networks: fitted to a shape, bounded rigorously, saved.

`architecture` says what networks there are, `networks` and `hash_grid` compute them, `fit` and
`family` train them, `leaf` makes fields of them, `enclosure` bounds them on boxes, `storing` puts
them on disk. Public names are listed in `fields`.
"""
