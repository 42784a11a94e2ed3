"""What a recording is: the contract between capture (online) and solve (offline).

Owns the rig description, the events a session consists of, their MCAP encoding, the
writer, the reader and the loss ledger. Imports no other room of this project.
"""
