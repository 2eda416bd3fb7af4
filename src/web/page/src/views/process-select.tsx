import type { ProcessProfile } from "meshmend-client";
import { profiles } from "../state/profiles";
import { usePageWords } from "../words/page-locale";
import { useStore } from "./use-store";

/** A choice of the printing process. `value` is the profile's name, empty for none. */
export function ProcessSelect({ value, set, label }: { value: string; set: (process: string) => void; label: string }) {
  const { words } = usePageWords();
  const all = useStore(profiles);
  const isKnown = value === "" || all.some(({ profile }) => profile.name === value);
  if (all.length === 0) return null;
  const options = (isBuiltIn: boolean) => all.filter(({ built_in }) => built_in === isBuiltIn).map((one) => <Choice key={one.profile.name} of={one} />);
  return (
    <label class="field process">
      {label}
      <select value={value} onChange={(event) => set(event.currentTarget.value)}>
        <option value="">{words.noProcess}</option>
        {!isKnown && <option value={value}>{value}</option>}
        {options(true)}
        {all.some(({ built_in }) => !built_in) && <optgroup label={words.ownProcesses}>{options(false)}</optgroup>}
      </select>
    </label>
  );
}

function Choice({ of: { profile } }: { of: ProcessProfile }) {
  return <option value={profile.name}>{profile.title}</option>;
}
