-- The process profiles that tenants add to the built-in ones.
CREATE TABLE process_profiles (
    tenant     TEXT    NOT NULL,
    name       TEXT    NOT NULL,
    limits     TEXT    NOT NULL,                             -- printing::ProcessLimits
    version    INTEGER NOT NULL,
    created_at INTEGER NOT NULL,
    updated_at INTEGER NOT NULL,
    PRIMARY KEY (tenant, name)
) STRICT;
