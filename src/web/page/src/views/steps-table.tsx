import type { Report } from "meshmend-client";
import { usePageWords } from "../words/page-locale";

/** The steps in order, with their times. Steps without changes are only counted, unless they took long. */
export function StepsTable({ report, heading: Heading = "h3", all = false }: { report: Report; heading?: "h2" | "h3"; all?: boolean }) {
  const { words, figures } = usePageWords();
  const isTelling = (step: Report["steps"][number]): boolean => all || step.changed.length > 0 || Boolean(step.note) || step.milliseconds > 200;
  const telling = report.steps.filter(isTelling);
  const idle = report.steps.length - telling.length;
  return (
    <div class="scroll">
      <Heading>{words.steps}</Heading>
      <table class="steps">
        <thead>
          <tr>
            <th scope="col">{words.step}</th>
            <th scope="col">{words.tier}</th>
            <th scope="col">{words.time}</th>
            <th scope="col">{words.changed}</th>
          </tr>
        </thead>
        <tbody>
          {telling.map((step, i) => (
            <tr key={i} class={step.status}>
              <th scope="row">{(step.operator ?? step.action).replaceAll("_", " ")}</th>
              <td>{step.tier || "–"}</td>
              <td>{figures.seconds(step.milliseconds)}</td>
              <td>
                {step.changed.map(({ kind, count }) => `${figures.count(count)} ${kind.replaceAll("_", " ")}`).join(", ")}
                {step.program && ` ${step.program.kind} ${step.program.version}`}
                {step.note && (
                  <span class="aside" lang="en">
                    {" "}
                    {step.note}
                  </span>
                )}
              </td>
            </tr>
          ))}
        </tbody>
      </table>
      {idle > 0 && <p class="aside">{words.stepsIdle(idle)}</p>}
    </div>
  );
}
