"""Foreign label formats, one file each."""
