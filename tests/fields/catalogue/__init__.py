"""Fields on which the laws are tested, by topic.

Every module here has `EXAMPLES`, fields by label, and `SURFACES`, primitives with an independent
description of their surface; both may be empty. `tests/fields/conftest.py` collects all of them.
"""
