"""Tries an installed wheel without any other package: python try_wheel.py"""

import meshmend

corners = [(x, y, z) for x in (0, 9) for y in (0, 9) for z in (0, 9)]
sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
faces = [face for a, b, c, d in sides for face in ((a, b, c), (a, c, d))]
result = meshmend.repair((corners, faces[1:]))
assert result.outcome == "repaired" and result.faces.shape == (12, 3), result.summary
assert meshmend.inspect(result.bytes).is_printable
print(meshmend.__version__, result.summary)
