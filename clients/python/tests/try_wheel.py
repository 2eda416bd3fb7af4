"""Tries an installed wheel without any other package: python try_wheel.py"""

import meshmend

vertices = [[0, 0, 0], [10, 0, 0], [0, 10, 0], [0, 0, 10]]
result = meshmend.repair((vertices, [[0, 2, 1], [0, 1, 3], [0, 3, 2]]))
assert result.outcome == "repaired" and result.faces.shape == (4, 3), result.report
assert meshmend.inspect(result.bytes).is_printable
print(meshmend.__version__, result.summary)
