"""Effects that are in no catalogue, to try whether an analysis owns up to what it does not know.

They are hidden by ``outsider:NAME@WHERE=SIZE``, never by chance, and cannot be described in a rig.
"""
