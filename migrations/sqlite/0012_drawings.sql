-- Ended jobs whose pictures somebody has asked for, until they are drawn.
CREATE TABLE drawings (
    job_id           TEXT    NOT NULL PRIMARY KEY,
    tenant           TEXT    NOT NULL,
    asked_at         INTEGER NOT NULL,
    attempt          INTEGER NOT NULL DEFAULT 0,
    lease_token      TEXT,
    lease_expires_at INTEGER
) STRICT;
