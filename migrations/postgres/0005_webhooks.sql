-- Who is told of jobs that end, what they are told, and how often it was tried.
CREATE TABLE webhook_endpoints (
    id               TEXT COLLATE "C" NOT NULL PRIMARY KEY, -- we_ and a UUID of version 7
    tenant           TEXT COLLATE "C" NOT NULL,
    url              TEXT    NOT NULL,
    description      TEXT    NOT NULL,
    events           TEXT    NOT NULL,                         -- names with commas between
    secret           TEXT    NOT NULL,                         -- whsec_ and base64; signatures can't be made from a hash of it
    old_secret       TEXT,                                     -- signs beside the other until
    old_secret_until BIGINT,
    created_at       BIGINT  NOT NULL,
    failing_since    BIGINT,                                  -- of the first failure after the last success
    disabled_at      BIGINT,
    disabled_reason  TEXT,
    CHECK ((old_secret IS NULL) = (old_secret_until IS NULL)),
    CHECK ((disabled_at IS NULL) = (disabled_reason IS NULL))
);
CREATE INDEX webhook_endpoints_by_tenant ON webhook_endpoints (tenant, id);

-- What signs calls to the addresses that jobs name themselves, one a tenant.
CREATE TABLE callback_secrets (
    tenant           TEXT COLLATE "C" NOT NULL PRIMARY KEY,
    secret           TEXT    NOT NULL,
    old_secret       TEXT,
    old_secret_until BIGINT
);

CREATE TABLE webhook_messages (
    id         TEXT COLLATE "C" NOT NULL PRIMARY KEY, -- msg_ and a UUID of version 7
    job_id     TEXT,
    type       TEXT    NOT NULL,
    payload    TEXT    NOT NULL,                               -- the very bytes to send
    created_at BIGINT  NOT NULL
);
CREATE INDEX webhook_messages_by_job ON webhook_messages (job_id);
CREATE INDEX webhook_messages_by_age ON webhook_messages (created_at);

-- The outbox: a message for one receiver. While one is under way, next_at is when its lease ends.
CREATE TABLE webhook_deliveries (
    id          TEXT COLLATE "C" NOT NULL PRIMARY KEY, -- whd_ and a UUID of version 7
    message_id  TEXT COLLATE "C" NOT NULL REFERENCES webhook_messages (id) ON DELETE CASCADE,
    tenant      TEXT COLLATE "C" NOT NULL,
    endpoint_id TEXT COLLATE "C" REFERENCES webhook_endpoints (id) ON DELETE CASCADE,
    url         TEXT,                                          -- of a job's own callback
    status      TEXT    NOT NULL CHECK (status IN ('pending', 'delivered', 'failed')),
    tries       BIGINT  NOT NULL DEFAULT 0,
    attempts    TEXT    NOT NULL DEFAULT '[]',                 -- list of jobs::Attempt, the last ones
    next_at     BIGINT  NOT NULL,
    lease_token TEXT,
    CHECK ((endpoint_id IS NULL) <> (url IS NULL)),
    CHECK (lease_token IS NULL OR status = 'pending')
);
CREATE INDEX webhook_deliveries_due ON webhook_deliveries (tenant, next_at, id) WHERE status = 'pending';
CREATE INDEX webhook_deliveries_under_way ON webhook_deliveries (tenant, next_at) WHERE lease_token IS NOT NULL;
CREATE INDEX webhook_deliveries_by_message ON webhook_deliveries (message_id);
CREATE INDEX webhook_deliveries_by_endpoint ON webhook_deliveries (endpoint_id, id);
CREATE INDEX webhook_deliveries_by_tenant ON webhook_deliveries (tenant, id);

-- Wakes those who deliver, in every process.
CREATE FUNCTION meshmend_tell_of_deliveries() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    PERFORM pg_notify('meshmend_jobs', 'webhooks');
    RETURN NULL;
END
$$;
CREATE TRIGGER webhook_deliveries_added AFTER INSERT ON webhook_deliveries
    FOR EACH STATEMENT EXECUTE FUNCTION meshmend_tell_of_deliveries();
