"""Views of played episodes, one file each: rows → document → table."""
