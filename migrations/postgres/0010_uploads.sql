-- Files that clients send before they ask for a job.
CREATE TABLE uploads (
    id           TEXT   NOT NULL PRIMARY KEY,    -- upl_ and a UUID of version 7
    tenant       TEXT   NOT NULL DEFAULT 'default',
    name         TEXT,
    token_sha256 TEXT,                           -- of what an address of this service must say
    created_at   BIGINT NOT NULL,
    job_id       TEXT                            -- the job that was made of it
);

CREATE INDEX uploads_waiting ON uploads (created_at) WHERE job_id IS NULL;
