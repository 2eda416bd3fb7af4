import { useEffect, useState } from "preact/hooks";
import { type Capabilities, type Job, Problem, type Status, listJobs } from "meshmend-client";
import { lockIfUnauthorized, server } from "../state/server";
import { usePageWords } from "../words/page-locale";
import { StatusChip } from "./chips";
import { Health } from "./health";
import { ProblemNote } from "./problem-note";

const STATUSES = ["queued", "running", "succeeded", "failed", "canceled", "expired"];
const PAGE = 25;
/** Interval of refreshing the list while a listed job is unfinished, in milliseconds. */
const AGAIN_MS = 3000;

/** All jobs that the key may see, newest first, and the health of the service. */
export function JobsPage({ can }: { can: Capabilities | null }) {
  const { words } = usePageWords();
  const [status, setStatus] = useState<Status | "">("");
  const [jobs, setJobs] = useState<Job[] | null>(null);
  const [next, setNext] = useState<string | null>(null);
  const [problem, setProblem] = useState<Problem | null>(null);
  const [round, setRound] = useState(0);

  const read = async (cursor: string | null): Promise<void> => {
    try {
      const page = await listJobs(server, status, cursor, PAGE);
      setJobs((known) => (cursor ? [...(known ?? []), ...page.jobs] : page.jobs));
      setNext(page.next);
      setProblem(null);
    } catch (error) {
      const problem = error instanceof Problem ? error : Problem.unreachable();
      lockIfUnauthorized(problem);
      setProblem(problem);
    }
  };
  useEffect(() => void read(null), [status, round]);
  const isBusy = jobs?.some((job) => job.status === "queued" || job.status === "running") ?? false;
  useEffect(() => {
    // Only the first page refreshes, so that the user does not lose their place in the list.
    if (!isBusy || (jobs?.length ?? 0) > PAGE) return;
    const timer = setTimeout(() => document.visibilityState === "visible" && setRound((round) => round + 1), AGAIN_MS);
    return () => clearTimeout(timer);
  }, [isBusy, jobs]);

  return (
    <div class="operate">
      <section class="card jobs">
        <div class="heading">
          <h1>{words.jobsTitle}</h1>
          <label>
            <span>{words.filter}</span>
            <select value={status} onChange={(event) => (setJobs(null), setStatus(event.currentTarget.value as Status | ""))}>
              <option value="">{words.all}</option>
              {STATUSES.map((option) => (
                <option key={option} value={option}>
                  {words.statuses[option]}
                </option>
              ))}
            </select>
          </label>
          <button type="button" class="plain" onClick={() => setRound(round + 1)}>
            {words.refresh}
          </button>
        </div>
        {problem && <ProblemNote problem={problem} />}
        <JobTable jobs={jobs} />
        {next && (
          <button type="button" class="plain more" onClick={() => void read(next)}>
            {words.more}
          </button>
        )}
      </section>
      <Health can={can} />
    </div>
  );
}

function JobTable({ jobs }: { jobs: Job[] | null }) {
  const { words, figures } = usePageWords();
  if (jobs === null) return <p class="nothing">{words.loading}</p>;
  if (jobs.length === 0) return <p class="nothing">{words.noJobs}</p>;
  const took = (job: Job): string =>
    job.started_at && job.finished_at && !job.reused_from ? figures.seconds(Date.parse(job.finished_at) - Date.parse(job.started_at)) : "–";
  return (
    <div class="scroll">
      <table>
        <thead>
          <tr>
            <th scope="col">{words.file}</th>
            <th scope="col">{words.status}</th>
            <th scope="col">{words.created}</th>
            <th scope="col" class="number">
              {words.took}
            </th>
          </tr>
        </thead>
        <tbody>
          {jobs.map((job) => (
            <tr key={job.id}>
              <th scope="row">
                <a href={`#/jobs/${job.id}`}>{job.input.name}</a>
                <span class="aside"> {figures.bytes(job.input.bytes)}</span>
              </th>
              <td>
                <StatusChip job={job} />
              </td>
              <td>
                <time dateTime={job.created_at}>{figures.time(job.created_at)}</time>
              </td>
              <td class="number">{took(job)}</td>
            </tr>
          ))}
        </tbody>
      </table>
    </div>
  );
}
