export function JobsPage(_: { can: unknown }) { return <p>jobs</p>; }
