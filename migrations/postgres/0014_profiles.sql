-- The process profiles that tenants add to the built-in ones.
CREATE TABLE process_profiles (
    tenant     TEXT COLLATE "C" NOT NULL,
    name       TEXT COLLATE "C" NOT NULL,
    limits     TEXT   NOT NULL,                              -- printing::ProcessLimits
    version    BIGINT NOT NULL,
    created_at BIGINT NOT NULL,
    updated_at BIGINT NOT NULL,
    PRIMARY KEY (tenant, name)
);
