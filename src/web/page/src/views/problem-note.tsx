import type { FieldError } from "meshmend-client";
import { useWords } from "../words/words";
import { Icon } from "./icons";

interface Noted {
  code: string;
  title: string;
  detail: string;
  errors?: readonly FieldError[];
}

/** What went wrong, in the service's words, and what to do, in the reader's. A form shows the errors of its own fields itself: `without` has them. */
export function ProblemNote({ problem, without = [] }: { problem: Noted; without?: readonly FieldError[] }) {
  const { words } = useWords();
  const advice = words.advice[problem.code];
  const errors = (problem.errors ?? []).filter((error) => !without.includes(error) && error.message !== problem.detail);
  return (
    <div class="problem" role="alert">
      <Icon name="warn" />
      <div>
        <p class="what">{advice ?? (problem.title || words.problem)}</p>
        {problem.detail && <p class="detail">{problem.detail}</p>}
        {errors.length > 0 && (
          <ul class="detail">
            {errors.map(({ field, message }) => (
              <li key={`${field} ${message}`}>{message}</li>
            ))}
          </ul>
        )}
        <p class="code">{words.problemCode(problem.code)}</p>
      </div>
    </div>
  );
}
