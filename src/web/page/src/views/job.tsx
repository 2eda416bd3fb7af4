import { useEffect, useRef, useState } from "preact/hooks";
import { type Capabilities, type Job, type Progress, Problem, cancelJob, deleteJob, follow, getJob, hasEnded } from "meshmend-client";
import { isRepair, optionsOf } from "../report/advice";
import { save } from "../state/download";
import { weightOf } from "../report/files";
import { lockIfUnauthorized, server } from "../state/server";
import { usePageWords } from "../words/page-locale";
import { StatusChip } from "./chips";
import { Facts } from "./facts";
import { Icon } from "./icons";
import { JobLog } from "./job-log";
import { ProblemNote } from "./problem-note";
import { RetryForm } from "./retry-form";
import { StepsTable } from "./steps-table";

/** One job for the operator: its steps and timings, log, files and actions. */
export function JobPage({ id, can }: { id: string; can: Capabilities | null }) {
  const { words, figures } = usePageWords();
  const [job, setJob] = useState<Job | null>(null);
  const [progress, setProgress] = useState<Progress | null>(null);
  const [problem, setProblem] = useState<Problem | null>(null);
  const [isFileGone, setGone] = useState(false);

  const trying = async (work: () => Promise<void>): Promise<void> => {
    try {
      setProblem(null);
      await work();
    } catch (error) {
      const problem = error instanceof Problem ? error : new Problem(0, "unexplained", String(error), "");
      lockIfUnauthorized(problem);
      setProblem(problem);
    }
  };
  useEffect(() => {
    const stop = new AbortController();
    setJob(null);
    setGone(false);
    const load = async (): Promise<void> => {
      const now = await getJob(server, id, stop.signal);
      setJob(now);
      setProgress(now.progress);
      if (!hasEnded(now)) setJob(await follow(server, id, setProgress, stop.signal));
    };
    void trying(async () => {
      await load().catch((error: unknown) => {
        if (!stop.signal.aborted) throw error;
      });
    });
    return () => stop.abort();
  }, [id]);

  const back = (
    <a class="back" href="#/jobs">
      <Icon name="arrow" size={16} /> {words.backToJobs}
    </a>
  );
  if (isFileGone) return <section class="card job-page">{back}<p class="nothing" role="status">{words.purged}</p></section>;
  if (!job) return <section class="card job-page">{back}{problem ? <ProblemNote problem={problem} /> : <p class="nothing">{words.loading}</p>}</section>;
  const report = job.report?.mode === "repair" ? job.report : null;
  const under = !hasEnded(job);
  return (
    <section class="card job-page">
      {back}
      <div class="heading">
        <h1>{job.input.name}</h1>
        <StatusChip job={job} />
        <div class="actions">
          {"defects.glb" in job.artifacts && (
            <a class="button" href={`#/result/${job.id}`}>
              <Icon name="eye" /> {words.showResult}
            </a>
          )}
          {under && (
            <button type="button" class="plain" onClick={() => void trying(async () => setJob(await cancelJob(server, id)))}>
              {words.cancel}
            </button>
          )}
          <Purge
            purge={() =>
              void trying(async () => {
                await deleteJob(server, id);
                setGone(true);
              })
            }
          />
        </div>
      </div>
      <p class="aside">{job.id}</p>
      {problem && <ProblemNote problem={problem} />}
      {job.problem && <ProblemNote problem={job.problem} />}
      {under && progress && (
        <div class="bar" role="status">
          <progress max={100} value={progress.percent} aria-label={words.percent} />
          <span>{progress.stage ? words.stages[progress.stage] : progress.queue_position === null ? words.stages.queue : words.queuePlace(progress.queue_position)}</span>
        </div>
      )}
      <Times job={job} />
      {report && <p>{report.summary}</p>}
      <Files job={job} save={(name) => void trying(() => save(job.artifacts[name]!))} bytes={(n) => figures.bytes(n)} />
      {report && <StepsTable report={report} heading="h2" all />}
      <JobLog job={job} />
      <RetryForm job={job} can={can} />
    </section>
  );
}

/** The times and the options of a job. */
function Times({ job }: { job: Job }) {
  const { words, figures } = usePageWords();
  const time = (iso: string | null): number => (iso ? Date.parse(iso) : Number.NaN);
  const span = (from: string | null, to: string | null): string => (from && to ? figures.seconds(time(to) - time(from)) : "–");
  const list: [string, string][] = [
    [words.created, figures.time(job.created_at)],
    [words.waited, span(job.created_at, job.started_at)],
    [words.ran, span(job.started_at, job.finished_at)],
    [words.attempt, String(job.attempt)],
    [words.preset, String(optionsOf(job)["preset"] ?? (isRepair(job) ? "auto" : optionsOf(job)["mode"]))],
  ];
  return <Facts list={list} look="times" />;
}

function Files({ job, save, bytes }: { job: Job; save: (name: string) => void; bytes: (n: number) => string }) {
  const { words } = usePageWords();
  const names = Object.keys(job.artifacts);
  if (names.length === 0) return null;
  return (
    <div>
      <h2>{words.filesTitle}</h2>
      <ul class="artifacts">
        {names.map((name) => (
          <li key={name}>
            <button type="button" class="link" onClick={() => save(name)}>
              {name}
            </button>
            <span class="aside">{weightOf(job, name) > 0 ? bytes(weightOf(job, name)) : ""}</span>
          </li>
        ))}
      </ul>
    </div>
  );
}

/** Deletes after a confirmation. */
function Purge({ purge }: { purge: () => void }) {
  const { words } = usePageWords();
  const dialog = useRef<HTMLDialogElement>(null);
  return (
    <>
      <button type="button" class="plain danger" onClick={() => dialog.current?.showModal()}>
        {words.purge}
      </button>
      <dialog ref={dialog} aria-labelledby="purge-ask">
        <p id="purge-ask">{words.purgeAsk}</p>
        <div class="actions">
          <button type="button" class="plain" onClick={() => dialog.current?.close()}>
            {words.purgeNo}
          </button>
          <button
            type="button"
            class="plain danger"
            onClick={() => {
              dialog.current?.close();
              purge();
            }}
          >
            {words.purgeYes}
          </button>
        </div>
      </dialog>
    </>
  );
}
