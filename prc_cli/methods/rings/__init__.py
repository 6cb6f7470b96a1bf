"""Labels of spinning scanners with rings; design/rings.md gives the method."""
