// The summary dialog: coverage of each actuator's range of angles, length of the end vectors and the floor of the angle
// error that follows, and the labeller's repeatability. The figures come from the server (API.md, summary).

import { byId, element } from "./elements.js";
import { formatAngle } from "./marks.js";

// Below this floor the angle is precise enough for a hysteresis loop: 30 labels of 1 px with end vectors of about 40 px.
const GOOD_FLOOR_DEG = 0.6;

/** repeats: {due, done, target}; startRepeats(): called when the user starts a round of repeat labels. */
export function showSummary(summary, repeats, startRepeats) {
  const dialog = byId("summary");
  const start = () => {
    dialog.close();
    startRepeats();
  };
  dialog.replaceChildren(
    element(
      "div",
      { class: "dialog-head" },
      element("h2", { id: "summary-title" }, "How good the labels are"),
      element("button", { type: "button", class: "text-button", onclick: () => dialog.close() }, "Close"),
    ),
    summary.actuators.length ? actuators(summary.actuators) : element("p", {}, "Nothing is labelled yet."),
    advice(summary.actuators),
    element("h3", {}, "Your own spread"),
    spread(summary.spread),
    element(
      "div",
      { class: "dialog-foot" },
      element("span", { class: "fine" }, `${repeats.done} of ${repeats.target} repeats done`),
      element(
        "button",
        { type: "button", class: "main", disabled: !repeats.due, onclick: start },
        repeats.due ? `Label ${repeats.due} again, blind` : "No repeat is due",
      ),
    ),
  );
  dialog.showModal();
}

function actuators(rows) {
  const number = (value, digits, unit) => (value === null || value === undefined ? "–" : `${value.toFixed(digits)}${unit}`);
  const angle = (value) => (value === null || value === undefined ? "–" : formatAngle(value, 0));
  const headings = [
    ["Actuator", ""],
    ["Labelled", "frames labelled, of all"],
    ["Angles", "smallest to largest labelled angle"],
    ["Largest gap", "widest stretch of the range without a labelled frame"],
    ["L", "length of the shorter end vector, px"],
    ["Floor", "best angle error to hope for from these labels: 2 σ / (√n L)"],
  ];
  return element(
    "table",
    { class: "figures" },
    element("thead", {}, element("tr", {}, ...headings.map(([text, title]) => element("th", { scope: "col", title }, text)))),
    element(
      "tbody",
      {},
      ...rows.map((row) =>
        element(
          "tr",
          {},
          element("th", { scope: "row" }, row.name),
          element("td", {}, `${row.n_labelled} / ${row.n_frames}`),
          element("td", {}, row.angle_min_deg === null ? "–" : `${angle(row.angle_min_deg)} … ${angle(row.angle_max_deg)}`),
          element("td", { title: gapPlace(row) }, angle(row.largest_gap_deg)),
          element("td", {}, number(row.end_vector_px, 0, " px")),
          element(
            "td",
            { class: row.floor_deg > GOOD_FLOOR_DEG ? "warning" : "", title: `σ = ${row.sigma_px.toFixed(2)} px, ${row.sigma_measured ? "measured" : "assumed"}` },
            number(row.floor_deg, 2, "°"),
          ),
        ),
      ),
    ),
  );
}

function gapPlace({ largest_gap_at_deg: at }) {
  return at ? `between ${formatAngle(at[0], 0)} and ${formatAngle(at[1], 0)}` : "";
}

function advice(rows) {
  const short = rows.filter((row) => row.floor_deg > GOOD_FLOOR_DEG);
  const sigma = rows.some((row) => row.sigma_measured) ? "your measured spread" : "an assumed label noise of 1 px";
  const paragraphs = [
    element("p", { class: "fine" }, `No network can know the angle better than the floor: 2 σ / (√n L), with ${sigma}. `,
      "It falls with the length L of the end vectors, so place the two points of an end far apart, and with more frames."),
  ];
  if (short.length) {
    paragraphs.push(
      element(
        "p",
        { class: "advice" },
        `Place the two points of an end as far apart as the part stays rigid (${short.map((row) => row.name).join(", ")}): `,
        "twice the distance halves the floor, as much as four times the frames.",
      ),
    );
  }
  return element("div", {}, ...paragraphs);
}

function spread(figures) {
  if (!figures) {
    return element(
      "p",
      { class: "fine" },
      "Not known yet. A share of the labelled frames is shown again without its points. The distance of your second labels from the first is your label noise: no network can be shown to be better.",
    );
  }
  const range = (low, high, unit) => (low === null || low === undefined ? "" : ` (${low.toFixed(2)} to ${high.toFixed(2)}${unit})`);
  const figure = (value, text, note) =>
    element("div", { class: "figure" }, element("b", { class: "numbers" }, value), element("span", {}, text), element("span", { class: "fine numbers" }, note));
  return element(
    "div",
    { class: "figure-row" },
    figure(`${figures.px.toFixed(2)} px`, "per point", `${figures.n_points} points${range(figures.px_low, figures.px_high, " px")}`),
    figures.deg === null
      ? null
      : figure(`${figures.deg.toFixed(2)}°`, "in the angle", `${figures.n_angles} angles${range(figures.deg_low, figures.deg_high, "°")}`),
  );
}
