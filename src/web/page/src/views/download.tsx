import { useEffect, useRef, useState } from "preact/hooks";
import { type Capabilities, type Job, Problem } from "meshmend-client";
import { claimsOf } from "../report/verdict";
import { convert, save } from "../state/download";
import { lockIfUnauthorized } from "../state/server";
import { usePageWords } from "../words/page-locale";
import { Icon } from "./icons";
import { ProblemNote } from "./problem-note";

/** Download buttons for the result, in its format or another. */
export function Download({ job, can, isAlternative }: { job: Job; can: Capabilities | null; isAlternative: boolean }) {
  const { words, figures } = usePageWords();
  const [making, setMaking] = useState("");
  const [problem, setProblem] = useState<Problem | null>(null);
  const stop = useRef(new AbortController());
  useEffect(() => () => stop.current.abort(), []);
  const { model, original, isPrintable } = claimsOf(job);
  const format = String(job.report?.mode === "repair" ? (job.report.output?.format ?? "") : "").toUpperCase();

  const doing = async (work: () => Promise<void>): Promise<void> => {
    setProblem(null);
    try {
      await work();
    } catch (error) {
      if (stop.current.signal.aborted) return;
      const problem = error instanceof Problem ? error : new Problem(0, "unexplained", String(error), "");
      lockIfUnauthorized(problem);
      setProblem(problem);
    } finally {
      setMaking("");
    }
  };
  const other = (wanted: string): void => {
    setMaking(wanted.toUpperCase());
    void doing(async () => save(await convert(job, wanted, isAlternative, stop.current.signal)));
  };
  const others = (can?.output_formats ?? []).filter((other) => other.toUpperCase() !== format);
  const small = [
    [original, words.downloadOriginal],
    [job.artifacts["report.json"], words.downloadReport],
    [job.artifacts["log.txt"], words.downloadLog],
  ] as const;
  return (
    <section class="download">
      {model && (
        <>
          <button type="button" class={isPrintable ? "primary large" : "plain large"} onClick={() => void doing(() => save(model))}>
            <Icon name="download" /> {words.download(format)} <span class="size">{figures.bytes(model.bytes ?? 0)}</span>
          </button>
          <label class="other">
            <span class="hidden">{words.otherFormat}</span>
            <select value="" disabled={making !== ""} onChange={(event) => other(event.currentTarget.value)}>
              <option value="" disabled>
                {making ? words.converting(making) : words.otherFormat}
              </option>
              {others.map((other) => (
                <option key={other} value={other}>
                  {other.toUpperCase()}
                </option>
              ))}
            </select>
          </label>
        </>
      )}
      <p class="links">
        {small.map(
          ([artifact, text]) =>
            artifact && (
              <button key={text} type="button" class="link" onClick={() => void doing(() => save(artifact))}>
                {text}
              </button>
            ),
        )}
      </p>
      {problem && <ProblemNote problem={problem} />}
    </section>
  );
}
