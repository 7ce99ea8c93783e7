// The button that ends labelling, where a command waits for the labels (bendtrack angle --label).

import { send } from "./api.js";
import { byId } from "./elements.js";
import { showEmpty } from "./empty_page.js";
import { showMessage } from "./message.js";

/** Show the button; it works once all points of some frame are placed. `ended` is called when the server has agreed. */
export function offerFinish({ list, queue, clientId, ended }) {
  const button = byId("finish");
  button.hidden = false;
  const update = () => {
    button.disabled = !list.rows.some((row) => row.state === "labelled" && !row.n_not_visible);
    button.title = button.disabled ? "Place all points of this frame first" : "Measure the videos with these labels";
  };
  for (const name of ["list", "row"]) list.addEventListener(name, update);
  update();
  button.addEventListener("click", async () => {
    button.disabled = true;
    const onDisk = await queue.drained();
    try {
      if (!onDisk) throw new Error("some edits are not on disk yet");
      await send("POST", "/api/finish", { client_id: clientId, edit_id: crypto.randomUUID() });
    } catch (error) {
      showMessage(`Not measured yet: ${error.message}.`, 8000);
      return update();
    }
    ended();
    document.querySelector("header").hidden = true;
    return showEmpty("Measuring", "The command that opened this page goes on in its terminal. The page can be closed.", "bendtrack angle --label");
  });
}
