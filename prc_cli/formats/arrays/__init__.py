"""Range images as NumPy arrays (``.npy``, ``.npz``)."""
