// Dragging the design's dot in the stability map: the dot follows the pointer at once, and each place of it is an event
// "dot" of the map with natural frequency and inertia share. The server answers with the map of the newest place.
(() => {
  let drag = null;

  const follow = () => {
    // plotly draws the dot anew with each answer of the server, at the place of that answer
    const path = drag.plot.querySelector(".shapelayer path");
    const shape = drag.plot._fullLayout.shapes[0];
    const { xaxis, yaxis } = drag.plot._fullLayout;
    if (path) path.setAttribute("transform",
      `translate(${drag.x - xaxis.d2p(shape.xanchor)},${drag.y - yaxis.d2p(shape.yanchor)})`);
  };

  const within = (value, axis) => Math.min(Math.max(value, 0), axis._length);

  addEventListener("pointerdown", (event) => {
    const path = event.target.closest?.(".map .shapelayer path");
    if (!path || event.button) return;
    const plot = path.closest(".js-plotly-plot");
    const shape = plot._fullLayout.shapes[0];
    const { xaxis, yaxis } = plot._fullLayout;
    const x = xaxis.d2p(shape.xanchor), y = yaxis.d2p(shape.yanchor);
    drag = { plot, x, y, offsetX: x - event.clientX, offsetY: y - event.clientY,
      observer: new MutationObserver(() => drag && follow()) };
    drag.observer.observe(plot.querySelector(".shapelayer"), { childList: true, subtree: true });
    event.preventDefault();
    event.stopPropagation();
  }, true);

  addEventListener("pointermove", (event) => {
    if (!drag) return;
    const { xaxis, yaxis } = drag.plot._fullLayout;
    drag.x = within(event.clientX + drag.offsetX, xaxis);
    drag.y = within(event.clientY + drag.offsetY, yaxis);
    follow();
    drag.plot.dispatchEvent(new CustomEvent("dot", { bubbles: true,
      detail: { frequency: xaxis.p2d(drag.x), share: yaxis.p2d(drag.y) } }));
  }, true);

  const end = () => {
    drag?.observer.disconnect();
    drag = null;
  };
  addEventListener("pointerup", end, true);
  addEventListener("pointercancel", end, true);
})();
