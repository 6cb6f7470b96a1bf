"""Raw dumps of fixed-size records."""
