"""Offline: a recording becomes averaged poses, selected poses, parameters, and a report.

The data walks one way: `samples` -> `mechanism` -> `estimate` -> `poses` -> `report`.
Pure numerics: no clock, no socket, no global random generator.
"""
