import { useState } from "preact/hooks";
import { type Capabilities, type Job, type Options, Problem } from "meshmend-client";
import { readinessOf } from "../report/print-ready";
import type { Unit } from "../units";
import { Alternatives } from "../views/alternatives";
import { Facts } from "../views/facts";
import { PrintReady } from "../views/print-ready";
import { ProblemNote } from "../views/problem-note";
import { Thickness } from "../views/thickness";
import { UnitAndSize } from "../views/unit-and-size";
import { UnitQuestion } from "../views/unit-question";
import { Verdict } from "../views/verdict";
import { WhatToDo } from "../views/what-to-do";
import type { Viewer } from "../viewer/viewer";
import { useWords } from "../words/locale";
import { ModelView } from "./model-view";
import { metricsOf } from "./metrics";
import type { Session } from "./session";
import { useTexts } from "./texts";

interface Props {
  session: Session;
  /** The job as the service describes it. */
  own: Job;
  /** The job as if the chosen result were its only one. */
  job: Job;
  can: Capabilities | null;
  unit: Unit;
  choice: string;
}

/** The result: both models, verdict and numbers, and what may help if the model is not printable. */
export function Outcome({ session, own, job, can, unit, choice }: Props) {
  const texts = useTexts();
  const { words } = useWords();
  const server = session.server;
  const report = job.report?.mode === "repair" ? job.report : null;
  const readiness = readinessOf(job);
  const [viewer, setViewer] = useState<Viewer | null>(null);
  const [problem, setProblem] = useState<Problem | null>(null);
  const choose = (id: string): void => {
    setProblem(null);
    session.choose(id).catch((error: unknown) => setProblem(Problem.from(error)));
  };
  const reason = problem ?? job.problem;
  const retry = (options: Options): void => session.again(options);
  const hasThickness = report !== null && session.isFree("thickness") && session.isFree("open_sheets");
  return (
    <section class={isSeen(job) ? "outcome" : "outcome alone"}>
      {server && isSeen(job) && <ModelView job={job} server={server} file={session.file} shown={setViewer} />}
      <div class="side">
        <div class="told" role="region" aria-label={texts.result} tabIndex={0}>
          <div part="verdict">
            <Verdict job={job} unit={unit} heading="h2">
              <Measures job={job} unit={unit} />
            </Verdict>
          </div>
          {reason && <ProblemNote problem={reason} />}
          {report && session.isFree("unit") && session.isFree("scale_to") && <UnitQuestion job={job} report={report} retry={retry} heading="h3" />}
          {server && <Alternatives job={own} server={server} unit={unit} choice={choice} choose={choose} heading="h3" />}
          {readiness && <PrintReady job={job} readiness={readiness} heading="h3" retry={retry} maySet={(option) => session.isFree(option)} />}
          {hasThickness && <Thickness key={choice} job={job} report={report} viewer={viewer} retry={retry} heading="h3" />}
          <WhatToDo job={job} can={can} retry={retry} />
          {report && session.isFree("unit") && session.isFree("scale_to") && (
            <details class="settings">
              <summary>{words.unitAndSize}</summary>
              <UnitAndSize job={job} report={report} file={session.file} retry={retry} send={(file, options) => session.take(file, options)} heading="h3" />
            </details>
          )}
        </div>
        <div class="actions">
          <button type="button" class="plain" part="button" onClick={() => session.reset()}>
            {texts.another}
          </button>
        </div>
      </div>
    </section>
  );
}

function isSeen(job: Job): boolean {
  return "defects.glb" in job.artifacts || "before.png" in job.artifacts;
}

/** The numbers that an order is priced with. */
function Measures({ job, unit }: { job: Job; unit: Unit }) {
  const { words, figures } = useWords();
  const metrics = metricsOf(job);
  if (!metrics) return null;
  const { sizeMm, volumeMm3, areaMm2, thinnestWallMm } = metrics;
  const list: (readonly [string, string])[] = [[words.size, figures.box(sizeMm, unit)]];
  if (volumeMm3 !== null) list.push([words.volume, figures.volume(volumeMm3, unit)]);
  if (areaMm2 !== null) list.push([words.area, figures.area(areaMm2, unit)]);
  if (thinnestWallMm !== null) list.push([words.measures.thinnest, figures.length(thinnestWallMm, unit, 3)]);
  return (
    <div part="facts">
      <Facts list={list} look="facts" />
    </div>
  );
}
