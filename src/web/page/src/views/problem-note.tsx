import { useWords } from "../words/words";
import { Icon } from "./icons";

/** What went wrong, in the service's words, and what to do, in the reader's. */
export function ProblemNote({ problem }: { problem: { code: string; title: string; detail: string } }) {
  const { words } = useWords();
  const advice = words.advice[problem.code];
  return (
    <div class="problem" role="alert">
      <Icon name="warn" />
      <div>
        <p class="what">{advice ?? (problem.title || words.problem)}</p>
        {problem.detail && <p class="detail">{problem.detail}</p>}
        <p class="code">{words.problemCode(problem.code)}</p>
      </div>
    </div>
  );
}
