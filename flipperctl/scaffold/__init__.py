"""The first files of a new plugin, from templates."""
