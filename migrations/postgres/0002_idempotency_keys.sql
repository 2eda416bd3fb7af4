-- Keys that clients sent so that a repeated request makes no second job.
CREATE TABLE idempotency_keys (
    key         TEXT   NOT NULL PRIMARY KEY,
    job_id      TEXT   NOT NULL,      -- the job, or the one that is to be made
    fingerprint TEXT,                 -- of the accepted request; null while it is under way
    expires_at  BIGINT NOT NULL
);
