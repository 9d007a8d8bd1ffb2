"use strict";
(async () => {
  const darkOf = JSON.parse(document.getElementById("dark").textContent);
  const night = matchMedia("(prefers-color-scheme: dark)");
  const touched = matchMedia("(pointer: coarse)").matches;
  const config = {
    responsive: true, displaylogo: false, displayModeBar: touched ? false : "hover",
    modeBarButtonsToRemove: ["select2d", "lasso2d", "autoScale2d", "zoomIn2d", "zoomOut2d", "orbitRotation", "resetCameraLastSave3d"],
    toImageButtonOptions: { format: "png", scale: 2 },
  };
  const figures = [...document.querySelectorAll("figure[data-name]")].map((element) => ({
    name: element.dataset.name,
    text: element.querySelector("script").textContent,
    plot: element.querySelector(".plot"),
    image: element.querySelector("img"),
  }));

  // A figure is written in light colours; each has its dark counterpart.
  const parsed = (text, dark) => {
    const figure = JSON.parse(dark ? text.replace(/#[0-9a-f]{6}\b/g, (c) => darkOf[c] ?? c) : text);
    figure.layout.autosize = true;
    // A finger on a plane figure moves the page.
    if (touched) figure.layout.dragmode = false;
    return figure;
  };
  const draw = (figure) => {
    const { data, layout } = parsed(figure.text, night.matches);
    // On a narrow screen the names of the legend stand beneath each other.
    const named = data.filter((trace) => trace.showlegend !== false).length;
    if (figure.plot.clientWidth < 600 && named > 2) layout.height += 19 * (named - 2);
    const eye = layout.scene?.camera.eye;
    if (eye && figure.plot.clientWidth < 600) for (const c of "xyz") eye[c] *= 1.3;
    figure.plot.style.height = `${layout.height}px`;
    return Plotly.react(figure.plot, data, layout, config);
  };
  const drawAll = async () => { for (const figure of figures) await draw(figure); };

  // Paper has its own width and is white: a picture of each figure stands ready for it.
  const picture = async (figure) => {
    const { data, layout } = parsed(figure.text, false);
    const size = { width: 760, height: Math.round(layout.height * 0.92) };
    figure.image.src = await Plotly.toImage({ data, layout: { ...layout, ...size } }, { format: "svg", ...size });
    figure.image.alt = layout.title?.text ?? figure.name;
    await figure.image.decode?.().catch(() => {});
  };

  night.addEventListener("change", drawAll);
  addEventListener("beforeprint", () => document.querySelectorAll("details").forEach((d) => { d.open = true; }));
  await drawAll();
  document.documentElement.dataset.drawn = "yes";
  for (const figure of figures) await picture(figure);
  document.documentElement.dataset.ready = "yes";
})();
