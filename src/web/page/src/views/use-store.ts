import { useEffect, useState } from "preact/hooks";
import type { Store } from "../state/store";

/** The value of a store; the view renders again when it changes. */
export function useStore<T>(store: Store<T>): T {
  const [value, set] = useState(store.value);
  useEffect(() => {
    set(() => store.value);
    return store.listen(() => set(() => store.value));
  }, [store]);
  return value;
}
