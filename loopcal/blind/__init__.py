"""The blind benchmark: nature hides an effect, the solver is given the recording only, a scorer compares.

Cases are laid out (`grid`), made and sealed (`making`, with `strength`), analysed (`answering`,
from the recording file alone), and scored (`score`, the only one that reads what was sealed).
"""
