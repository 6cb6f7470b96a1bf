// A click on a picture shows it in its full size; another click or Escape closes it.
document.addEventListener("click", (event) => {
  const open = document.querySelector(".enlarged");
  if (open) {
    open.remove();
    return;
  }
  if (!event.target.matches("figure > img")) return;
  const box = document.createElement("div");
  box.className = "enlarged";
  box.append(event.target.cloneNode());
  document.body.append(box);
});
document.addEventListener("keydown", (event) => {
  if (event.key === "Escape") document.querySelector(".enlarged")?.remove();
});
