-- Whose a job is, what it was asked with, and results that are used again or have expired.
ALTER TABLE jobs
    ADD COLUMN tenant       TEXT COLLATE "C" NOT NULL DEFAULT 'default',
    ADD COLUMN made_by      TEXT,                                   -- the key it was submitted with
    ADD COLUMN metadata     TEXT NOT NULL DEFAULT '{}',             -- the client's own
    ADD COLUMN callback_url TEXT,
    ADD COLUMN fingerprint  TEXT,                                   -- of bytes, options and engine
    ADD COLUMN reused_from  TEXT,                                   -- the job whose result this one was given
    DROP CONSTRAINT jobs_status_check,
    ADD CONSTRAINT jobs_status_check
        CHECK (status IN ('queued', 'running', 'succeeded', 'failed', 'canceled', 'expired')),
    DROP CONSTRAINT jobs_check2,
    ADD CONSTRAINT jobs_finished_check
        CHECK ((status IN ('succeeded', 'failed', 'canceled', 'expired')) = (finished_at IS NOT NULL));
ALTER TABLE jobs ALTER COLUMN tenant DROP DEFAULT;

DROP INDEX jobs_due;
DROP INDEX jobs_by_status;
CREATE INDEX jobs_due ON jobs (tenant, run_at, id) WHERE status = 'queued';
CREATE INDEX jobs_running ON jobs (tenant) WHERE status = 'running';
CREATE INDEX jobs_served ON jobs (tenant, started_at);
CREATE INDEX jobs_by_tenant ON jobs (tenant, id);
CREATE INDEX jobs_by_status ON jobs (tenant, status, id);
CREATE INDEX jobs_reusable ON jobs (tenant, fingerprint) WHERE status = 'succeeded';
CREATE INDEX jobs_ended ON jobs (finished_at) WHERE finished_at IS NOT NULL;

-- What single tenants may use; null where the service's own limits hold.
CREATE TABLE tenants (
    name                TEXT COLLATE "C" NOT NULL PRIMARY KEY,
    max_queued          BIGINT,
    max_running         BIGINT,
    requests_per_minute BIGINT
);

-- API keys, and the tokens that pages hold for a while.
CREATE TABLE access_keys (
    id           TEXT   COLLATE "C" NOT NULL PRIMARY KEY,      -- key_ and a UUID of version 7
    secret_hash  TEXT   NOT NULL UNIQUE,                       -- SHA-256 of the secret
    tenant       TEXT   NOT NULL,
    kind         TEXT   NOT NULL CHECK (kind IN ('api', 'browser')),
    label        TEXT   NOT NULL,
    scopes       TEXT   NOT NULL,                              -- access::Scopes
    origin       TEXT,
    max_bytes    BIGINT,
    parent       TEXT,                                         -- the key that it was made with
    created_at   BIGINT NOT NULL,
    expires_at   BIGINT,
    revoked_at   BIGINT,
    last_used_at BIGINT
);

-- A tenant's idempotency keys are its own.
DROP TABLE idempotency_keys;
CREATE TABLE idempotency_keys (
    tenant      TEXT   NOT NULL,
    key         TEXT   NOT NULL,
    job_id      TEXT   NOT NULL,      -- the job, or the one that is to be made
    fingerprint TEXT,                 -- of the accepted request; null while it is under way
    expires_at  BIGINT NOT NULL,
    PRIMARY KEY (tenant, key)
);
CREATE INDEX idempotency_keys_expired ON idempotency_keys (expires_at);
