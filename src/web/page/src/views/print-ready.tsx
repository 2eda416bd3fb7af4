import type { ComponentChildren } from "preact";
import type { Job, Options, PrintReadiness, RuleResult } from "meshmend-client";
import { mendingOptions, ruleValue, sortedRules } from "../report/print-ready";
import { useWords } from "../words/locale";
import { Icon } from "./icons";

interface Props {
  job: Job;
  readiness: PrintReadiness;
  heading?: "h2" | "h3";
  /** The name of the file, if the job has several. */
  name?: string | undefined;
  /** Submits another job with other options, if the user may. */
  retry?: ((options: Options) => void) | undefined;
  /** A button that shows the places of a rule. */
  placesOf?: ((rule: RuleResult) => ComponentChildren) | undefined;
}

/** Whether the file meets each rule of the process: limit, measured value, and what to do. */
export function PrintReady({ job, readiness, heading: Heading = "h2", name, retry, placesOf }: Props) {
  const { words, figures } = useWords();
  const rules = sortedRules(readiness);
  const count = (result: RuleResult["result"]): number => rules.filter((rule) => rule.result === result).length;
  const [failed, undecided] = [count("fail"), count("undecided")];
  return (
    <section class={readiness.ready ? "print-ready good" : "print-ready"}>
      <Heading>{name ? `${words.printReady}: ${name}` : words.printReady}</Heading>
      <p role="status">
        <Icon name={readiness.ready ? "check" : "warn"} size={18} /> {readiness.ready && words.readyFor(readiness.title)}
        {failed > 0 && words.notReadyFor(readiness.title, failed)} {undecided > 0 && words.undecidedRules(undecided)}
      </p>
      <div class="scroll">
        <table class="rules">
          <thead>
            <tr>
              <th scope="col">{words.rule}</th>
              <th scope="col">{words.ruleResult}</th>
              <th scope="col">{words.limit}</th>
              <th scope="col">{words.measured}</th>
              <th scope="col">{words.remedy}</th>
            </tr>
          </thead>
          <tbody>
            {rules.map((rule) => (
              <Row key={rule.rule} rule={rule} options={mendingOptions(job, rule)} retry={retry} places={placesOf?.(rule)} />
            ))}
          </tbody>
        </table>
      </div>
      <p class="aside">{figures.count(rules.length - failed - undecided)} / {figures.count(rules.length)}</p>
    </section>
  );
}

interface RowProps {
  rule: RuleResult;
  /** The options of a job that mends the rule. */
  options: Options | null;
  retry: ((options: Options) => void) | undefined;
  places: ComponentChildren;
}

function Row({ rule: { rule, result, severity, limit, measured, count, remedy }, options, retry, places }: RowProps) {
  const { words, figures } = useWords();
  const tell = words.remedies[rule];
  return (
    <tr class={result}>
      <th scope="row">{words.rules[rule] ?? rule}</th>
      <td>
        <span class={`chip ${result === "pass" ? "good" : result === "fail" ? "bad" : "fair"}`} title={severity ? words.severities[severity] : undefined}>
          {words.ruleResults[result]}
        </span>{" "}
        {count > 1 && words.rulePlaces(figures.count(count))} {places}
      </td>
      <td>{ruleValue(rule, limit, figures)}</td>
      <td>{ruleValue(rule, measured, figures)}</td>
      <td>
        {result === "fail" && (tell ? tell(ruleValue(rule, limit, figures)) : <span lang="en">{remedy}</span>)}{" "}
        {options && retry && (
          <button type="button" class="link" onClick={() => retry(options)}>
            {words.mendRule}
          </button>
        )}
      </td>
    </tr>
  );
}
