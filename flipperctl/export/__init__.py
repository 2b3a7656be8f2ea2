"""Policies as files for the robot, compared with torch before they are written."""
