#!/usr/bin/env python3
"""Charts and a page from the table of pipelines/accuracy: accuracy_report.py FOLDER

Reads FOLDER/accuracy.csv and FOLDER/pictures, draws with gnuplot and writes FOLDER/index.html, which needs no other file.
Exits with 1 when --quality auto loses or invents a hit, or is somewhere more than 10 % off the Pareto front in instructions;
a table without them has only the clock, which is printed and not judged.

accuracy_report.py --compare FOLDER OTHER says column by column where two runs differ in what is not a time, their pictures
included, and exits with 1 when they do.
"""
import base64
import csv
import html
import math
import os
import sys

from accuracy_charts import draw_all
from accuracy_table import HOLLOW_PPM, NEAR, SOLVES, Table, choices, cost_column, default_of, differences, floors, methods_of, number, over_all_fields, peers_of


def auto_words(table):
    """How near --quality auto is to the front."""
    found = choices(table)
    if not found:
        return "Its choices were not measured."
    worst = max(found, key=lambda c: c["ratio"])
    return (f"{sum(c['ratio'] <= NEAR for c in found)} of {len(found)} views within {100 * (NEAR - 1):.0f} % of the front in {cost_column(table)}, "
            f"the farthest {worst['ratio']:.3f} ({'{field} {size} at {family}'.format(**worst['row'])}); {sum(c['wrong'] > 0 for c in found)} with a wrong ray")


def judge_choices(table):
    """Prints how near --quality auto is to the front everywhere; returns whether it is near enough."""
    found = choices(table)
    if not found:
        return True
    print("--quality auto: " + auto_words(table))
    slowest = max(found, key=lambda c: c["clock_ratio"])
    print(f"by the clock (CPU time, medians of frames in pairs): {sum(c['clock_ratio'] <= NEAR for c in found)} of {len(found)}, "
          f"the farthest {slowest['clock_ratio']:.3f} of {slowest['row']['contender']} ({'{field} {size} at {family}'.format(**slowest['row'])})")
    counted = cost_column(table) == "instructions_per_ray"
    return all((c["ratio"] <= NEAR or not counted) and not c["wrong"] for c in found)


def inline_svg(folder, name):
    path = os.path.join(folder, name + ".svg")
    if not os.path.exists(path):
        return ""
    with open(path) as file:
        text = file.read()
    return "<div class=chart>" + text[text.index("<svg"):] + "</div>"


def inline_png(path):
    with open(path, "rb") as file:
        return "data:image/png;base64," + base64.b64encode(file.read()).decode()


def html_table(header, rows):
    out = "<table><tr>" + "".join(f"<th>{html.escape(h)}</th>" for h in header) + "</tr>\n"
    for row in rows:
        out += "<tr>" + "".join(f"<td>{html.escape(str(v))}</td>" for v in row) + "</tr>\n"
    return out + "</table>\n"


def short(value):
    return "" if math.isnan(value) else f"{value:.3g}"


def summary_table(table):
    """Per method: what it costs against the default, and the worst of all fields."""
    rows = [[p["solve"], p["steps"] or "", p["precision"], short(p["instructions"]), short(p["ns"]), short(p["p99"]), p["p99_field"], short(p["worst"]), p["worst_field"] if p["worst"] else ""]
            for p in over_all_fields(table)]
    return html_table(["solve", "steps", "precision", "instructions / default (median of fields)", "time / default", "worst p99 error, voxels", "in", "worst errors, ppm of rays", "in"], rows)


def recommendation_table(table):
    rows = []
    for field, size in table.fields():
        points = methods_of(table, field, size)
        floor, pixel = floors(table, field, size)
        bound = max(floor, pixel) / 10
        fit = [p for p in points if p["worst"] == 0 and p["p99"] <= bound]
        best = min(fit, key=lambda p: p["ns"]) if fit else None
        rows.append([f"{field} {size}", short(floor) if floor else "not known", short(pixel), short(bound),
                     f"{best['solve']} {best['steps'] or ''} {best['precision']}" if best else "none", short(best["ns"]) if best else ""])
    return html_table(["field", "field error, voxels", "half a pixel, voxels", "a tenth of the higher", "cheapest without errors", "ns/ray"], rows)


def auto_table(table):
    """What --quality auto takes at each distance, and how far that is from the front."""
    rows = []
    for c in choices(table):
        r = c["row"]
        rows.append([f'{r["field"]} {r["size"]}', r["family"], f'{r["intersect"]} {r["steps"]} {r["precision"]}', r["gradient"], r["bound"], r["depth_p99"], f'{c["wrong"]:.3g}',
                     r["instructions_per_ray"], r["ns_per_ray"], f'{c["ratio"]:.3f}', f'{c["bound_ratio"]:.3f}', r["contender"], f'{c["clock_ratio"]:.3f}'])
    return html_table(["field", "eye", "intersect", "gradient", "bound, voxels", "p99 error", "wrong rays, ppm", "instructions/ray", "ns/ray", "cost / the front's",
                       "cost / the cheapest's within the bound", "contender by the clock", "time / the contender's"], rows)


def peer_table(table):
    """The default beside the marching-cubes mesh and a device, timed in the same turns."""
    rows = []
    for field, size in table.fields():
        for p in peers_of(table, field, size):
            r = p["row"]
            rows.append([f"{field} {size}", p["tracer"], r["isa"], r["ns_per_ray"], f'{p["ratio"]:.2f}', r["depth_p50"], r["depth_p99"],
                         r["depth_max"], short(p["worst"]), r["bytes"]])
    if not rows:
        return "<p>Nothing else was measured.</p>"
    return html_table(["field", "tracer", "on", "ns/ray", "time / the default's", "median error, voxels", "p99", "worst", "wrong rays, ppm", "bytes"], rows)


def mesh_table(table):
    rows = [[r["field"], r["family"], f'{r["intersect"]} {r["steps"]} {r["precision"]}', r["depth_p50"], r["depth_p99"], r["false_positive"], r["false_negative"], r["leaks"], r["rays"]]
            for r in table.select(kind="solve", truth="mesh")]
    return html_table(["field", "rays", "solve", "median, voxels", "p99", "false hits", "false misses", "leaks", "of"], rows) if rows else "<p>No mesh was measured.</p>"


def all_rows(table):
    chosen = ["kind", "field", "size", "structure", "samples", "tracer", "intersect", "steps", "precision", "gradient", "truth", "family", "rays", "tangent", "true_positive",
              "false_positive", "false_negative", "true_negative", "leaks", "wrong_face", "depth_p50", "depth_p99", "depth_max", "normal_p99", "ns_per_ray", "instructions_per_ray", "bytes"]
    return html_table(chosen, [[r[c] for c in chosen] for r in table.rows])


def pictures(folder):
    out = ""
    for shape, words in (("pairs", "random samples"), ("shell", "a shell of 0.9 voxel"), ("gyroid", "a slab of the gyroid"), ("rotated-box", "a box at odd angles")):
        out += f"<h3>{words}</h3><div class=row>"
        for solve in SOLVES:
            path = os.path.join(folder, "pictures", f"{shape}-{solve}")
            if os.path.exists(path + ".png"):
                out += f"<figure><img src='{inline_png(path + '.png')}'><br><img src='{inline_png(path + '-error.png')}'><figcaption>{solve}</figcaption></figure>"
        out += "</div>\n"
    return out


def escapes_section(folder):
    """What the full form sent from inside closed fields, all fields in one row; none of it may leave."""
    path = os.path.join(folder, "escapes.csv")
    if not os.path.exists(path):
        return ""
    sums = {}
    with open(path, newline="") as file:
        for r in csv.DictReader(file):
            total = sums.setdefault((r["structure"], r["tracer"], r["isa"]), [0, 0, 0, 0])
            for i, count in enumerate((1, int(r["traced"]), int(r["escaped"]), int(r["tangent"]))):
                total[i] += count
    table = html_table(["structure", "tracer", "instruction set", "fields", "rays", "escaped", "tangents without a hit"], [[*key, *total] for key, total in sums.items()])
    return f"<h2>Nothing escapes</h2><p>Rays from inside closed fields, half of them exactly through corners, edges and faces: each must hit.</p><details><summary>The numbers</summary>{table}</details>"


def counted_text(table):
    ways = {(r["counted"], r["isa"]) for r in table.rows if r["counted"]}
    return ", ".join(sorted(f"{way}, {isa}" for way, isa in ways)) or "no counter of the processor could be read, and valgrind is missing, so there are none"


def default_words(table):
    default = default_of(over_all_fields(table))
    wrong = "no ray of any field is wrong" if not default["worst"] else f"at most {default['worst']:.3g} of 1e6 rays of a field are wrong ({default['worst_field']})"
    return f"{wrong}, and its error is {default['p99']:.2g} voxel (p99) in the worst field, far less than a picture can show."


def write_page(table, folder):
    first = table.rows[0]
    page = f"""<!doctype html><html lang=en><meta charset=utf-8><meta name=viewport content="width=device-width"><title>distfield: accuracy against time</title>
<style>:root{{color-scheme:light}}body{{font:15px/1.4 sans-serif;max-width:1300px;margin:2em auto;padding:0 1em;color:#111;background:#fff}}table{{border-collapse:collapse;font-size:13px}}
td,th{{border:1px solid #ccc;padding:2px 6px;text-align:left}}.row{{display:flex;flex-wrap:wrap}}figure{{margin:4px;width:200px;text-align:center}}
figure img{{width:200px}}.chart{{overflow-x:auto}}svg{{width:100%;min-width:900px;height:auto}}details{{margin:.6em 0;overflow-x:auto}}summary{{cursor:pointer;color:#0645ad}}p,ul{{max-width:62em}}</style>
<h1>Accuracy against time</h1>
<p>Take <b>robust</b>, the default: {default_words(table)} Nothing that isolates crossings in double costs noticeably less, as
a ray is solved once, in the voxel that holds its hit. Or let <b>--quality auto</b> choose: it takes the same solve, with fewer steps or in float where that cannot be seen.</p>
{inline_svg(folder, "overview")}
<p>Every mark is a method: the farther left the cheaper, the farther down the more exact, in the worst of all fields. Hollow marks are wrong on some rays: they hit what is not there, miss what is,
or are more than half a voxel off. Numbers beside curves are steps.</p>
<ul><li><b>midpoint</b>, <b>linear</b> and <b>repeated</b> look at the two ends of a voxel only, so thin walls and pairs of crossings are lost, whatever the number of steps.</li>
<li><b>marmitt</b> finds every crossing, but converges slowly where one end of its bracket stays.</li>
<li><b>analytic</b>, the closed form, is the slowest, and wrong where the cubic term is of the size of rounding.</li>
<li><b>f32</b> solves in float: fewer instructions, and hits that are as far off as floats are coarse.</li>
<li><b>Embree</b> and <b>OpenGL</b> draw the marching-cubes mesh of the same field, which is another surface than the field wherever that bends. An <b>OpenCL</b> device is as exact as the CPU.</li></ul>
<p>Machine: {html.escape(first["machine"])}. Compiler: {html.escape(first["compiler"])}. Version {html.escape(first["version"])}. Seed {first["seed"]}.
Errors are those of the solver against the trilinear field in quad precision; times are medians of whole frames, one thread, rays to shaded picture. Instructions: {counted_text(table)}.</p>
<details><summary>The numbers of each method</summary>{summary_table(table)}</details>
<h2>What failing looks like</h2><p>Above the picture, below its depth error: blue 1e-6 voxel and less, green 1e-3, red 1 and more; magenta a hole, white a hit of nothing.</p>{pictures(folder)}
<h2>Error against instructions, field by field</h2><p>Marks grow with the wrong rays over all families of rays; hollow: more than {HOLLOW_PPM} ppm. A name stands at its solve's most exact point in double, that of robust at 3 steps.</p>{inline_svg(folder, "pareto-instructions")}
<h2>Error against time, field by field</h2><p>The same by the clock; beside it the marching-cubes mesh of the same field (its bytes include Embree's tree) and an OpenCL device, one thread each. Their errors are against the trilinear field, over the camera's rays
(mc-raster, which draws pictures only: over the pixels of the chart's view); their times are of larger pictures, in turns with the default.</p>{inline_svg(folder, "pareto")}
<details><summary>The others' numbers</summary>{peer_table(table)}</details>
<h2>The cheapest that a scene needs</h2><p>The cheapest method without errors whose p99 error lies under a tenth of the higher of two floors.</p>{recommendation_table(table)}
<h2>What --quality auto takes</h2><p>{auto_words(table)}</p>
<details><summary>All views</summary><p>Against the measured front at three distances (rays from the eye to the field): the cheapest method with the same gradient that has no wrong ray there and is no less exact. Cost is {cost_column(table)}. The cheapest within the bound is known only after the truth is: it is another method in each view.
The last columns are the clock: of the three fastest methods that are sound there and no less exact, the one that does best when its frames and those of the choice are drawn in pairs, and the median of their ratios in CPU time.</p>{auto_table(table)}</details>
<h2>Against the mesh</h2><p>The whole pipeline: the mesh itself is the truth. What is left is the field's error; no solver that isolates changes it.</p><details><summary>The numbers</summary>{mesh_table(table)}</details>
<h2>Error against bytes</h2><p>What is left of the exact surface when its samples are stored, whatever the solver.</p>{inline_svg(folder, "storage")}
{escapes_section(folder)}
<h2>Normals</h2>{inline_svg(folder, "gradients")}
<details><summary>All rows</summary>{all_rows(table)}</details>
</html>
"""
    with open(os.path.join(folder, "index.html"), "w") as file:
        file.write(page)


def picture_of(path):
    """The part of a PNG that is seen, without its text, which names the command."""
    with open(path, "rb") as file:
        data = file.read()
    kept, at = [], 8
    while at < len(data):
        end = at + 12 + int.from_bytes(data[at:at + 4], "big")
        if data[at + 4:at + 8] in (b"IHDR", b"IDAT"):
            kept.append(data[at:end])
        at = end
    return kept


def compare_pictures(folders):
    lists = [set(os.listdir(os.path.join(folder, "pictures"))) for folder in folders if os.path.isdir(os.path.join(folder, "pictures"))] or [set()]
    both = sorted(set.intersection(*lists)) if len(lists) == 2 else []
    differing = [name for name in both if picture_of(os.path.join(folders[0], "pictures", name)) != picture_of(os.path.join(folders[1], "pictures", name))]
    alone = sorted(set.union(*lists) - set(both))
    print(f"pictures: {len(both)} in both, {len(differing)} differ{': ' if differing else ''}{', '.join(differing)}; {len(alone)} in one only")
    return not differing and not alone


def compare_runs(folders):
    """Prints where two runs differ; returns whether they are the same."""
    tables = [Table(os.path.join(folder, "accuracy.csv")) for folder in folders]
    alone, both, differing = differences(*tables)
    print(f"rows: {both} in both, {len(alone)} in one only")
    for key in alone[:5]:
        print("  only in one: " + " ".join(key))
    for column, found in differing.items():
        key, values = found[0]
        print(f"{column}: {len(found)} rows differ, the first is {' '.join(key)}: {values[0]} and {values[1]}")
    same = compare_pictures(folders) and not alone and not differing
    print("the runs are the same but for times" if same else "the runs differ")
    return same


def draw(folder):
    table = Table(os.path.join(folder, "accuracy.csv"))
    draw_all(table, folder)
    write_page(table, folder)
    return judge_choices(table)


def main():
    arguments = sys.argv[1:]
    if len(arguments) == 3 and arguments[0] == "--compare":
        good = compare_runs(arguments[1:])
    elif len(arguments) == 1 and not arguments[0].startswith("-"):
        good = draw(arguments[0])
    else:
        sys.exit("usage: accuracy_report.py FOLDER, or accuracy_report.py --compare FOLDER OTHER")
    sys.exit(0 if good else 1)


main()
