"""What a search believed, compared with the checker.

What a search believed of its certificate, in numbers that the checker computes again: a difference is an alarm.
"""

from .alarms import alarm, alarm_in, believed_along, believed_on_cells, is_canonical
