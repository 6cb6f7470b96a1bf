"""One module per command, under the command's name.

It reads, calls the layers below, and writes.
"""
