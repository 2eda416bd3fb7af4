import type { Capabilities, Job, Options } from "meshmend-client";
import { isUnfinished, suggestions } from "../report/advice";
import { useWords } from "../words/locale";

/** Suggestions for a model that was not repaired completely. */
export function WhatToDo({ job, can, retry }: { job: Job; can: Capabilities | null; retry: (options: Options) => void }) {
  const { words } = useWords();
  const list = suggestions(job, can);
  const isPartial = isUnfinished(job);
  if (list.length === 0 && !isPartial) return null;
  return (
    <section class="what-to-do">
      <h2>{words.whatToDo}</h2>
      {list.map(({ name, options }) => (
        <button key={name} type="button" class="plain choice" onClick={() => retry(options)}>
          <strong>{words[name]}</strong>
          <span>{words[`${name}More`]}</span>
        </button>
      ))}
      {isPartial && <p>{words.seeLeft}</p>}
    </section>
  );
}
