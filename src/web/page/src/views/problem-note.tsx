import type { FieldError } from "meshmend-client";
import { useWords } from "../words/locale";
import { Icon } from "./icons";

interface Noted {
  code: string;
  title: string;
  detail: string;
  errors?: readonly FieldError[];
}

/** A problem: the detail from the service, and translated advice. `without` lists the fields whose errors a form shows itself. */
export function ProblemNote({ problem, without = [] }: { problem: Noted; without?: readonly FieldError[] }) {
  const { words, withoutDetail = [] } = useWords();
  const hasDetail = problem.detail && !withoutDetail.includes(problem.code);
  const advice = words.advice[problem.code];
  const errors = (problem.errors ?? []).filter((error) => !without.includes(error) && error.message !== problem.detail);
  return (
    <div class="problem" role="alert">
      <Icon name="warn" />
      <div>
        <p class="what">{advice ?? (problem.title || words.problem)}</p>
        {hasDetail && <p class="detail">{problem.detail}</p>}
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
