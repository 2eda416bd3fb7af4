import { useRef } from "preact/hooks";
import type { Capabilities } from "meshmend-client";
import { endings, isModel } from "../state/files";
import { usePageWords } from "../words/page-locale";
import { Icon } from "./icons";

/** Buttons that open the dialogs for files and for a folder. */
export function ChooseFiles({ can, take, compact = false }: { can: Capabilities | null; take: (files: File[]) => void; compact?: boolean }) {
  const { words } = usePageWords();
  const files = useRef<HTMLInputElement>(null);
  const folder = useRef<HTMLInputElement>(null);
  const formats = can?.input_formats ?? [];
  const accept = endings(formats)
    .map((ending) => `.${ending}`)
    .join(",");
  const chosen = (input: HTMLInputElement, isFolder: boolean): void => {
    const all = [...(input.files ?? [])];
    take(isFolder ? all.filter((file) => isModel(file.name, formats)) : all);
    input.value = "";
  };
  return (
    <div class={compact ? "choose compact" : "choose"}>
      <input ref={files} type="file" multiple accept={accept} hidden onChange={(event) => chosen(event.currentTarget, false)} />
      <input ref={folder} type="file" hidden {...{ webkitdirectory: true }} onChange={(event) => chosen(event.currentTarget, true)} />
      <button type="button" class={compact ? "quiet" : "primary"} onClick={() => files.current?.click()}>
        <Icon name={compact ? "plus" : "upload"} /> {compact ? words.addMore : words.chooseFiles}
      </button>
      {!compact && (
        <button type="button" class="plain" onClick={() => folder.current?.click()}>
          <Icon name="folder" /> {words.chooseFolder}
        </button>
      )}
    </div>
  );
}
