"""PRC, classification of a raw range stream (Lehtola et al. 2019).

One file per stage; order in :mod:`.pipeline`.
"""
