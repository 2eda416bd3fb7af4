export function JobPage(_: { id: string; can: unknown }) { return <p>job</p>; }
