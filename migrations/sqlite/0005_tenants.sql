-- Whose a job is, what it was asked with, and results that are used again or have expired. SQLite changes no check, so the table is
-- made anew.
CREATE TABLE jobs_with_tenants (
    id               TEXT    NOT NULL PRIMARY KEY,           -- job_ and a UUID of version 7
    tenant           TEXT    NOT NULL,
    made_by          TEXT,                                   -- the key it was submitted with
    status           TEXT    NOT NULL
                     CHECK (status IN ('queued', 'running', 'succeeded', 'failed', 'canceled', 'expired')),
    outcome          TEXT,                                   -- jobs::JobOutcome
    attempt          INTEGER NOT NULL DEFAULT 0,
    crashes          INTEGER NOT NULL DEFAULT 0,
    created_at       INTEGER NOT NULL,
    run_at           INTEGER NOT NULL,
    started_at       INTEGER,
    finished_at      INTEGER,
    worker           TEXT,
    lease_token      TEXT,
    lease_expires_at INTEGER,
    ended_token      TEXT,                                   -- whose attempt ended last
    progress         TEXT,                                   -- jobs::JobProgress
    inputs           TEXT    NOT NULL,                       -- list of jobs::Input
    options          TEXT    NOT NULL,                       -- jobs::JobOptions
    metadata         TEXT    NOT NULL DEFAULT '{}',          -- the client's own
    callback_url     TEXT,
    fingerprint      TEXT,                                   -- of bytes, options and engine
    reused_from      TEXT,                                   -- the job whose result this one was given
    report           TEXT,                                   -- jobs::JobReport
    artifacts        TEXT    NOT NULL DEFAULT '{}',          -- jobs::Artifacts
    problem          TEXT,                                   -- jobs::JobProblem
    version          INTEGER NOT NULL DEFAULT 1,
    purged_at        INTEGER,
    -- a running job has a lease, and no other has
    CHECK ((status = 'running') = (lease_token IS NOT NULL)),
    CHECK ((lease_token IS NULL) = (lease_expires_at IS NULL)),
    CHECK ((status IN ('succeeded', 'failed', 'canceled', 'expired')) = (finished_at IS NOT NULL))
) STRICT;
INSERT INTO jobs_with_tenants (id, tenant, status, outcome, attempt, crashes, created_at, run_at, started_at, finished_at, worker,
        lease_token, lease_expires_at, ended_token, progress, inputs, options, report, artifacts, problem, version, purged_at)
    SELECT id, 'default', status, outcome, attempt, crashes, created_at, run_at, started_at, finished_at, worker,
        lease_token, lease_expires_at, ended_token, progress, inputs, options, report, artifacts, problem, version, purged_at
    FROM jobs;
DROP TABLE jobs;
ALTER TABLE jobs_with_tenants RENAME TO jobs;

CREATE INDEX jobs_due ON jobs (tenant, run_at, id) WHERE status = 'queued';
CREATE INDEX jobs_running ON jobs (tenant) WHERE status = 'running';
CREATE INDEX jobs_leased ON jobs (lease_expires_at) WHERE status = 'running';
CREATE INDEX jobs_served ON jobs (tenant, started_at);
CREATE INDEX jobs_by_tenant ON jobs (tenant, id);
CREATE INDEX jobs_by_status ON jobs (tenant, status, id);
CREATE INDEX jobs_reusable ON jobs (tenant, fingerprint) WHERE status = 'succeeded';
CREATE INDEX jobs_ended ON jobs (finished_at) WHERE finished_at IS NOT NULL;

-- What single tenants may use; null where the service's own limits hold.
CREATE TABLE tenants (
    name                TEXT NOT NULL PRIMARY KEY,
    max_queued          INTEGER,
    max_running         INTEGER,
    requests_per_minute INTEGER
) STRICT;

-- API keys, and the tokens that pages hold for a while.
CREATE TABLE access_keys (
    id           TEXT    NOT NULL PRIMARY KEY,                 -- key_ and a UUID of version 7
    secret_hash  TEXT    NOT NULL UNIQUE,                      -- SHA-256 of the secret
    tenant       TEXT    NOT NULL,
    kind         TEXT    NOT NULL CHECK (kind IN ('api', 'browser')),
    label        TEXT    NOT NULL,
    scopes       TEXT    NOT NULL,                             -- access::Scopes
    origin       TEXT,
    max_bytes    INTEGER,
    parent       TEXT,                                         -- the key that it was made with
    created_at   INTEGER NOT NULL,
    expires_at   INTEGER,
    revoked_at   INTEGER,
    last_used_at INTEGER
) STRICT;

-- A tenant's idempotency keys are its own.
DROP TABLE idempotency_keys;
CREATE TABLE idempotency_keys (
    tenant      TEXT    NOT NULL,
    key         TEXT    NOT NULL,
    job_id      TEXT    NOT NULL,     -- the job, or the one that is to be made
    fingerprint TEXT,                 -- of the accepted request; null while it is under way
    expires_at  INTEGER NOT NULL,
    PRIMARY KEY (tenant, key)
) STRICT;
CREATE INDEX idempotency_keys_expired ON idempotency_keys (expires_at);
