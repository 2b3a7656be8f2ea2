"""Export of policies as files for the robot; each is compared with torch before writing."""
