"""What all writers share: outputs that exist whole or not at all, their options and their run record."""
