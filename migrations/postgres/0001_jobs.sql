-- One row a job; the queue is the rows with status 'queued', in order of (run_at, id).
-- Times are milliseconds since the Unix epoch, by this database's clock. Columns of JSON hold the types named beside them, as
-- text, since JSONB takes no \u0000.
CREATE TABLE jobs (
    id               TEXT    COLLATE "C" NOT NULL PRIMARY KEY, -- job_ and a UUID of version 7
    status           TEXT    NOT NULL CHECK (status IN ('queued', 'running', 'succeeded', 'failed', 'canceled')),
    outcome          TEXT,                                   -- repair::Outcome
    attempt          BIGINT  NOT NULL DEFAULT 0,
    crashes          BIGINT  NOT NULL DEFAULT 0,
    created_at       BIGINT  NOT NULL,
    run_at           BIGINT  NOT NULL,
    started_at       BIGINT,
    finished_at      BIGINT,
    worker           TEXT,
    lease_token      TEXT,
    lease_expires_at BIGINT,
    ended_token      TEXT,                                   -- whose attempt ended last
    progress         TEXT,                                   -- jobs::JobProgress
    inputs           TEXT    NOT NULL,                       -- list of jobs::Input
    options          TEXT    NOT NULL,                       -- jobs::JobOptions
    report           TEXT,                                   -- jobs::JobReport
    artifacts        TEXT    NOT NULL DEFAULT '{}',          -- jobs::Artifacts
    problem          TEXT,                                   -- jobs::JobProblem
    version          BIGINT  NOT NULL DEFAULT 1,
    purged_at        BIGINT,
    -- a running job has a lease, and no other has
    CHECK ((status = 'running') = (lease_token IS NOT NULL)),
    CHECK ((lease_token IS NULL) = (lease_expires_at IS NULL)),
    CHECK ((status IN ('succeeded', 'failed', 'canceled')) = (finished_at IS NOT NULL))
);

CREATE INDEX jobs_due ON jobs (run_at, id) WHERE status = 'queued';
CREATE INDEX jobs_leased ON jobs (lease_expires_at) WHERE status = 'running';
CREATE INDEX jobs_by_status ON jobs (status, id);

-- Leases are of many machines, whose clocks differ: the time is this database's, but for tests, which give theirs.
CREATE FUNCTION meshmend_now(given BIGINT) RETURNS BIGINT LANGUAGE sql STABLE AS $$
    SELECT coalesce(given, (extract(epoch FROM statement_timestamp()) * 1000)::bigint)
$$;

-- Wakes workers, and those who wait for a job, in every process.
CREATE FUNCTION meshmend_tell() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    PERFORM pg_notify('meshmend_jobs', NEW.id || ' ' || NEW.status);
    RETURN NULL;
END
$$;
CREATE TRIGGER jobs_added AFTER INSERT ON jobs FOR EACH ROW EXECUTE FUNCTION meshmend_tell();
CREATE TRIGGER jobs_changed AFTER UPDATE ON jobs FOR EACH ROW WHEN (NEW.version <> OLD.version)
    EXECUTE FUNCTION meshmend_tell();
