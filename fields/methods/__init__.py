"""The methods of `fields.Field`, by topic."""
