"""What a person gets from a solve: the HTML report, and a summary for the terminal.

Imports nothing by itself: what only words a number (`notation`) does not pay for pictures.
"""
