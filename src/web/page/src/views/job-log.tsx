import { useState } from "preact/hooks";
import { type Job, Problem, fetchArtifact } from "meshmend-client";
import { server } from "../state/server";
import { usePageWords } from "../words/page-locale";
import { ProblemNote } from "./problem-note";

/** The log of the job and of Blender, loaded when opened. */
export function JobLog({ job }: { job: Job }) {
  const { words } = usePageWords();
  const [text, setText] = useState<string | null>(null);
  const [problem, setProblem] = useState<Problem | null>(null);
  const artifact = job.artifacts["log.txt"];
  const opened = async (event: Event): Promise<void> => {
    if (!(event.currentTarget as HTMLDetailsElement).open || text !== null || !artifact) return;
    try {
      setText(new TextDecoder().decode(await fetchArtifact(server, artifact)));
    } catch (error) {
      setProblem(error instanceof Problem ? error : Problem.unreachable());
    }
  };
  return (
    <details class="log" onToggle={(event) => void opened(event)}>
      <summary>{words.log}</summary>
      {problem && <ProblemNote problem={problem} />}
      {artifact ? (
        <pre tabIndex={0} aria-label={words.log}>
          {text ?? words.loading}
        </pre>
      ) : (
        <p class="aside">{words.noLog}</p>
      )}
    </details>
  );
}
