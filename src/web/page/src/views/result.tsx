import { useEffect, useRef, useState } from "preact/hooks";
import { type Capabilities, type Job, type Options, Problem } from "meshmend-client";
import { DEFAULT_CHOICE } from "../report/alternatives";
import { server } from "../state/server";
import { settings } from "../state/settings";
import { again, sendFile } from "../state/items";
import { jobOfChoice } from "../state/job";
import { usePageWords } from "../words/page-locale";
import { Alternatives } from "./alternatives";
import { Download } from "./download";
import { Layers } from "./layers";
import { Numbers } from "./numbers";
import { Objects } from "./objects";
import { Printing } from "./printing";
import { ProblemNote } from "./problem-note";
import { ProcessCheck } from "./process-check";
import { Share } from "./share";
import { Thickness } from "./thickness";
import { UnitAndSize } from "./unit-and-size";
import { UnitQuestion } from "./unit-question";
import { useStore } from "./use-store";
import { Verdict } from "./verdict";
import { type Shown, ViewerPane } from "./viewer-pane";
import { WhatToDo } from "./what-to-do";

/** The result for a model: the verdict, both models in 3D, the files, and all numbers. */
export function Result({ job: own, file, can }: { job: Job; file: File | null; can: Capabilities | null }) {
  const { words } = usePageWords();
  const [{ choice, chosen }, setChosen] = useState<{ choice: string; chosen: Job | null }>({ choice: DEFAULT_CHOICE, chosen: null });
  const job = chosen ?? own;
  const report = job.report?.mode === "repair" ? job.report : null;
  const { unit } = useStore(settings);
  const [shown, setShown] = useState<Shown | null>(null);
  const [problem, setProblem] = useState<Problem | null>(null);
  const choosing = useRef(new AbortController());
  useEffect(() => () => choosing.current.abort(), []);
  const choose = (id: string): void => {
    choosing.current.abort();
    const { signal } = (choosing.current = new AbortController());
    setProblem(null);
    jobOfChoice(server, own, id, signal).then(
      (chosen) => signal.aborted || setChosen({ choice: id, chosen: id === DEFAULT_CHOICE ? null : chosen }),
      (error: unknown) => signal.aborted || setProblem(Problem.from(error)),
    );
  };
  const isUnderWay = useRef(false);
  const retry = (options: Options): void => {
    if (isUnderWay.current) return;
    isUnderWay.current = true;
    setProblem(null);
    again(job, options)
      .then(() => (location.hash = "#/"))
      .catch((error: unknown) => setProblem(Problem.from(error)))
      .finally(() => (isUnderWay.current = false));
  };
  const send = (copy: File, options: Options): void => {
    location.hash = "#/";
    sendFile(copy, options);
  };
  const isShown = "defects.glb" in job.artifacts;
  const hasPictures = "before.png" in job.artifacts;
  const isKept = job.status !== "expired";
  return (
    <article class="result">
      <div class={isShown || hasPictures ? "result-columns" : "result-columns alone"}>
        {isShown ? (
          <div class="stage">
            <ViewerPane job={job} file={file} shown={shown} setShown={setShown} />
          </div>
        ) : (
          hasPictures && <Pictures job={job} />
        )}
        <div class="side">
          <Verdict job={job} unit={unit} heading="h1" retry={retry} />
          {problem && <ProblemNote problem={problem} />}
          {job.problem && <ProblemNote problem={job.problem} />}
          {!isKept && <p>{words.expiredMore}</p>}
          {report && <UnitQuestion key={`unit-${job.id}`} job={job} report={report} retry={retry} />}
          {isKept && <Alternatives job={own} server={server} unit={unit} choice={choice} choose={choose} />}
          {report && <Thickness key={`thickness-${choice}`} job={job} report={report} viewer={shown?.viewer ?? null} retry={retry} />}
          <Download key={`download-${choice}`} job={job} can={can} isAlternative={choice !== DEFAULT_CHOICE} />
          <WhatToDo job={job} can={can} retry={retry} />
          {job.status === "succeeded" && !isShown && !hasPictures && <p class="aside">{words.noPreview}</p>}
          {isKept && <Share job={job} />}
        </div>
        <div class="tools-of-viewer">
          {isShown && <Layers job={job} shown={shown} />}
          {report && <UnitAndSize key={job.id} job={job} report={report} file={file} retry={retry} send={send} />}
          <Printing job={job} shown={shown} />
        </div>
      </div>
      <ProcessCheck key={choice} job={job} shown={shown} retry={retry} />
      {report?.objects && report.objects.length > 1 && <Objects objects={report.objects} />}
      {report && <Numbers report={report} />}
    </article>
  );
}

/** Without 3D: the pictures that the service drew. */
export function Pictures({ job }: { job: Job }) {
  const { words } = usePageWords();
  const drawn = ["before.png", "after.png", "defects.png"].filter((name) => name in job.artifacts);
  return (
    <div class="pictures">
      {drawn.map((name) => (
        <img key={name} src={job.artifacts[name]!.href} alt={name === "after.png" ? words.after : words.before} loading="lazy" />
      ))}
    </div>
  );
}
