"""PRC, classification of a raw range stream (Lehtola et al. 2019): a file a stage, in the order of :mod:`.pipeline`."""
