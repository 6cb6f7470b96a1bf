"""What the commands do, under the commands' names: one job reads, calls the layers below, and writes."""
