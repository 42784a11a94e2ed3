"""Effects that nature can hide: things at work that the rig description does not say."""
