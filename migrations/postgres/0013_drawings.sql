-- Ended jobs whose pictures somebody has asked for, until they are drawn.
CREATE TABLE drawings (
    job_id           text   NOT NULL PRIMARY KEY,
    tenant           text   NOT NULL,
    asked_at         bigint NOT NULL,
    attempt          bigint NOT NULL DEFAULT 0,
    lease_token      text,
    lease_expires_at bigint
);

-- Wakes workers, in every process.
CREATE FUNCTION meshmend_tell_of_drawings() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    PERFORM pg_notify('meshmend_jobs', 'drawings');
    RETURN NULL;
END
$$;
CREATE TRIGGER drawings_added AFTER INSERT ON drawings
    FOR EACH STATEMENT EXECUTE FUNCTION meshmend_tell_of_drawings();
