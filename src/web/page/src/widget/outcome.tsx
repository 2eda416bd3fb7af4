import type { Capabilities, Job } from "meshmend-client";
import type { Unit } from "../units";
import { Facts } from "../views/facts";
import { ProblemNote } from "../views/problem-note";
import { Verdict } from "../views/verdict";
import { WhatToDo } from "../views/what-to-do";
import { useWords } from "../words/words";
import { Look } from "./look";
import { metricsOf } from "./metrics";
import type { Session } from "./session";
import { useTexts } from "./texts";

/** What became of the model: to look at, in words and in numbers, and what may help where it can't be printed. */
export function Outcome({ session, job, can, unit }: { session: Session; job: Job; can: Capabilities | null; unit: Unit }) {
  const texts = useTexts();
  const server = session.server;
  return (
    <section class={isSeen(job) ? "outcome" : "outcome alone"}>
      {server && isSeen(job) && <Look job={job} server={server} />}
      <div class="side">
        <div class="told" role="region" aria-label={texts.result} tabIndex={0}>
          <div part="verdict">
            <Verdict job={job} unit={unit} heading="h2" />
          </div>
          {job.problem && <ProblemNote problem={job.problem} />}
          <WhatToDo job={job} can={can} retry={(options) => session.again(options)} />
          <Measures job={job} unit={unit} />
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

/** What an order is priced by. */
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
