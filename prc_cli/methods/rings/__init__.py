"""Labels of spinning scanners with rings; docs/rings.md gives the method."""
