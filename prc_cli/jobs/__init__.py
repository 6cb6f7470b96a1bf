"""One module per command, under the command's name: it reads, calls the layers below, and writes."""
