-- One row a job; the queue is the rows with status 'queued', in order of (run_at, id).
-- Times are milliseconds since the Unix epoch. JSON columns hold the types named beside them.
CREATE TABLE jobs (
    id               TEXT    NOT NULL PRIMARY KEY,           -- job_ and a UUID of version 7
    status           TEXT    NOT NULL CHECK (status IN ('queued', 'running', 'succeeded', 'failed', 'canceled')),
    outcome          TEXT,                                   -- repair::Outcome
    attempt          INTEGER NOT NULL DEFAULT 0,
    crashes          INTEGER NOT NULL DEFAULT 0,
    created_at       INTEGER NOT NULL,
    run_at           INTEGER NOT NULL,
    started_at       INTEGER,
    finished_at      INTEGER,
    worker           TEXT,
    lease_token      TEXT,
    lease_expires_at INTEGER,
    progress         TEXT,                                   -- jobs::JobProgress
    input            TEXT    NOT NULL,                       -- jobs::Input
    input_key        TEXT    NOT NULL,
    options          TEXT    NOT NULL,                       -- jobs::JobOptions
    report           TEXT,                                   -- repair::Report
    artifacts        TEXT    NOT NULL DEFAULT '{}',          -- jobs::Artifacts
    problem          TEXT,                                   -- jobs::JobProblem
    version          INTEGER NOT NULL DEFAULT 1,
    purged_at        INTEGER,
    -- a running job has a lease, and no other has
    CHECK ((status = 'running') = (lease_token IS NOT NULL)),
    CHECK ((lease_token IS NULL) = (lease_expires_at IS NULL)),
    CHECK ((status IN ('succeeded', 'failed', 'canceled')) = (finished_at IS NOT NULL))
) STRICT;

CREATE INDEX jobs_due ON jobs (run_at, id) WHERE status = 'queued';
CREATE INDEX jobs_leased ON jobs (lease_expires_at) WHERE status = 'running';
CREATE INDEX jobs_by_status ON jobs (status, id);
