"""What schemathesis could not find by itself, so that jobs run and their files are asked for."""

import schemathesis
from hypothesis import strategies

TETRAHEDRON = b"OFF\n4 4 6\n0 0 0\n9 0 0\n0 9 0\n0 0 9\n3 0 2 1\n3 0 1 3\n3 1 2 3\n3 2 0 3\n"
WITH_A_HOLE = b"v 0 0 0\nv 9 0 0\nv 0 9 0\nv 0 0 9\nf 1 3 2\nf 1 2 4\nf 2 3 4\n"

schemathesis.openapi.media_type("application/octet-stream", strategies.sampled_from([TETRAHEDRON, WITH_A_HOLE]))
