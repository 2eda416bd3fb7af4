-- Who is told of jobs that end, what they are told, and how often it was tried.
CREATE TABLE webhook_endpoints (
    id               TEXT    NOT NULL PRIMARY KEY,             -- we_ and a UUID of version 7
    tenant           TEXT    NOT NULL,
    url              TEXT    NOT NULL,
    description      TEXT    NOT NULL,
    events           TEXT    NOT NULL,                         -- names with commas between
    secret           TEXT    NOT NULL,                         -- whsec_ and base64; signatures can't be made from a hash of it
    old_secret       TEXT,                                     -- signs beside the other until
    old_secret_until INTEGER,
    created_at       INTEGER NOT NULL,
    failing_since    INTEGER,                                  -- of the first failure after the last success
    disabled_at      INTEGER,
    disabled_reason  TEXT,
    CHECK ((old_secret IS NULL) = (old_secret_until IS NULL)),
    CHECK ((disabled_at IS NULL) = (disabled_reason IS NULL))
) STRICT;
CREATE INDEX webhook_endpoints_by_tenant ON webhook_endpoints (tenant, id);

-- What signs calls to the addresses that jobs name themselves, one a tenant.
CREATE TABLE callback_secrets (
    tenant           TEXT    NOT NULL PRIMARY KEY,
    secret           TEXT    NOT NULL,
    old_secret       TEXT,
    old_secret_until INTEGER
) STRICT;

CREATE TABLE webhook_messages (
    id         TEXT    NOT NULL PRIMARY KEY,                   -- msg_ and a UUID of version 7
    job_id     TEXT,
    type       TEXT    NOT NULL,
    payload    TEXT    NOT NULL,                               -- the very bytes to send
    created_at INTEGER NOT NULL
) STRICT;
CREATE INDEX webhook_messages_by_job ON webhook_messages (job_id);
CREATE INDEX webhook_messages_by_age ON webhook_messages (created_at);

-- The outbox: a message for one receiver. While one is under way, next_at is when its lease ends.
CREATE TABLE webhook_deliveries (
    id          TEXT    NOT NULL PRIMARY KEY,                  -- whd_ and a UUID of version 7
    message_id  TEXT    NOT NULL REFERENCES webhook_messages (id) ON DELETE CASCADE,
    tenant      TEXT    NOT NULL,
    endpoint_id TEXT    REFERENCES webhook_endpoints (id) ON DELETE CASCADE,
    url         TEXT,                                          -- of a job's own callback
    status      TEXT    NOT NULL CHECK (status IN ('pending', 'delivered', 'failed')),
    tries       INTEGER NOT NULL DEFAULT 0,
    attempts    TEXT    NOT NULL DEFAULT '[]',                 -- list of jobs::Attempt, the last ones
    next_at     INTEGER NOT NULL,
    lease_token TEXT,
    CHECK ((endpoint_id IS NULL) <> (url IS NULL)),
    CHECK (lease_token IS NULL OR status = 'pending')
) STRICT;
CREATE INDEX webhook_deliveries_due ON webhook_deliveries (tenant, next_at, id) WHERE status = 'pending';
CREATE INDEX webhook_deliveries_under_way ON webhook_deliveries (tenant, next_at) WHERE lease_token IS NOT NULL;
CREATE INDEX webhook_deliveries_by_message ON webhook_deliveries (message_id);
CREATE INDEX webhook_deliveries_by_endpoint ON webhook_deliveries (endpoint_id, id);
CREATE INDEX webhook_deliveries_by_tenant ON webhook_deliveries (tenant, id);
