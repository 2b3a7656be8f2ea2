"""Write the first files of a new plugin from templates."""
