"""Class codes in record order: read out of any file that carries them, written as files of their own."""
