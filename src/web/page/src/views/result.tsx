import { useState } from "preact/hooks";
import type { Capabilities, Job, Options } from "meshmend-client";
import { settings } from "../state/settings";
import { again } from "../state/work";
import { useWords } from "../words/words";
import { Download } from "./download";
import { Numbers } from "./numbers";
import { Objects } from "./objects";
import { ProblemNote } from "./problem-note";
import { useStore } from "./use-store";
import { Verdict } from "./verdict";
import { ViewerPane } from "./viewer-pane";
import { WhatToDo } from "./what-to-do";

/** What became of a model: the verdict in words, both models to look at, the files, and all numbers. */
export function Result({ job, can }: { job: Job; can: Capabilities | null }) {
  const { words } = useWords();
  const report = job.report?.mode === "repair" ? job.report : null;
  const { unit } = useStore(settings);
  const retry = (options: Options): void => {
    location.hash = "#/";
    again(job, options);
  };
  const [side, setSide] = useState<HTMLElement | null>(null);
  const isShown = "defects.glb" in job.artifacts;
  const hasPictures = "before.png" in job.artifacts;
  return (
    <article class="result">
      <div class={isShown || hasPictures ? "stage-and-side" : "stage-and-side alone"}>
        {isShown ? (
          <div class="stage">
            <ViewerPane job={job} side={side} />
          </div>
        ) : (
          hasPictures && <Pictures job={job} />
        )}
        <div class="side">
          <Verdict job={job} unit={unit} heading="h1" />
          {job.problem && <ProblemNote problem={job.problem} />}
          {job.status === "expired" && <p>{words.expiredMore}</p>}
          <Download job={job} can={can} />
          <WhatToDo job={job} can={can} retry={retry} />
          {job.status === "succeeded" && !isShown && !hasPictures && <p class="aside">{words.noPreview}</p>}
          <div ref={setSide} class="tools-of-viewer" />
        </div>
      </div>
      {report?.objects && report.objects.length > 1 && <Objects objects={report.objects} />}
      {report && <Numbers report={report} />}
    </article>
  );
}

/** Where there is no 3D: the pictures that the service drew. */
export function Pictures({ job }: { job: Job }) {
  const { words } = useWords();
  const drawn = ["before.png", "after.png", "defects.png"].filter((name) => name in job.artifacts);
  return (
    <div class="pictures">
      {drawn.map((name) => (
        <img key={name} src={job.artifacts[name]!.href} alt={name === "after.png" ? words.after : words.before} loading="lazy" />
      ))}
    </div>
  );
}
