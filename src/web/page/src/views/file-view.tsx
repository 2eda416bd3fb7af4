import { useRef } from "preact/hooks";
import type { Capabilities } from "meshmend-client";
import { type FileItem, isFileGone, resume, stop } from "../state/items";
import { usePageWords } from "../words/page-locale";
import { ProblemNote } from "./problem-note";
import { Result } from "./result";
import { Stages } from "./stages";

/** One file: its progress or its result. */
export function FileView({ item, can }: { item: FileItem; can: Capabilities | null }) {
  const { words } = usePageWords();
  const input = useRef<HTMLInputElement>(null);
  if (item.phase === "ended" && item.job) return <Result key={item.job.id} job={item.job} file={item.file} can={can} />;
  if (item.phase === "refused" && item.problem) {
    return (
      <section class="card wide">
        <h1>{item.name}</h1>
        <ProblemNote problem={item.problem} />
        {!item.file && !item.job && isFileGone(item.problem) && Object.keys(item.options).length > 0 && (
          <>
            <p>{words.chooseAgainMore(item.name)}</p>
            <input
              ref={input}
              type="file"
              hidden
              onChange={(event) => {
                const file = event.currentTarget.files?.[0];
                if (file) resume(item.id, file);
              }}
            />
            <button type="button" class="primary" onClick={() => input.current?.click()}>
              {words.chooseAgain}
            </button>
          </>
        )}
        {item.file && !item.job && (
          <button type="button" class="primary" onClick={() => resume(item.id)}>
            {words.retry}
          </button>
        )}
      </section>
    );
  }
  return (
    <section class="card wide">
      <h1>{item.name}</h1>
      <Stages item={item} />
      <button type="button" class="plain" onClick={() => void stop(item.id)}>
        {words.cancel}
      </button>
    </section>
  );
}
