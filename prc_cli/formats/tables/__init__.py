"""Tables, CSV and Parquet: column by column in, one row a cell out."""
