"""PRC, classification of a raw range stream (Lehtola et al. 2019): one file per stage; order in :mod:`.pipeline`."""
