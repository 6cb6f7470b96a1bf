"""Tables: arrays and Parquet read by column, CSV and Parquet written with one row per cell."""
