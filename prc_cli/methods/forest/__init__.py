"""Ground, stems and other vegetation: what ``fused`` does in a forest."""
