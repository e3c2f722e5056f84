"""The page of a report: one file that needs nothing else."""

PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>{{ title }}</title>
<meta name="viewport" content="width=device-width, initial-scale=1">
<style>
:root { --ink: #202124; --soft: #5f6368; --line: #e3e6e8; --ground: #f6f7f8; --good: #00734f;
        --bad: #b3261e; --warn: #8a5a00; --mark: #0072b2; }
* { box-sizing: border-box; }
body { margin: 0; color: var(--ink); background: var(--ground); line-height: 1.45;
       font: 15px/1.45 system-ui, "Segoe UI", "DejaVu Sans", sans-serif; }
header, main { max-width: 1180px; margin: 0 auto; padding: 0 24px; }
header { padding-top: 28px; }
h1 { font-size: 24px; margin: 0 0 4px; overflow-wrap: anywhere; }
h2 { font-size: 17px; margin: 0 0 12px; }
h3 { font-size: 14px; margin: 14px 0 6px; color: var(--soft); font-weight: 600; }
nav { position: sticky; top: 0; background: var(--ground); border-bottom: 1px solid var(--line);
      margin: 16px 0 20px; padding: 10px 0; z-index: 2; }
nav a { color: var(--soft); text-decoration: none; margin-right: 16px; font-size: 14px;
        white-space: nowrap; }
nav a:hover { color: var(--mark); }
section { background: white; border: 1px solid var(--line); border-radius: 8px;
          padding: 18px 20px; margin-bottom: 18px; scroll-margin-top: 56px; }
.badge { display: inline-block; padding: 2px 10px; border-radius: 12px; font-size: 13px;
         font-weight: 600; color: white; background: var(--soft); margin-right: 6px; }
.good { background: var(--good); } .bad { background: var(--bad); }
.meta { color: var(--soft); font-size: 14px; margin: 6px 0 0; overflow-wrap: anywhere; }
.why { border-left: 4px solid var(--bad); background: #fdf3f2; padding: 10px 14px; margin: 14px 0 0;
       border-radius: 0 6px 6px 0; }
.note { border-left: 4px solid #e6a700; background: #fff8e6; padding: 10px 14px; margin: 14px 0 0;
        border-radius: 0 6px 6px 0; }
.tiles { display: grid; grid-template-columns: repeat(auto-fill, minmax(150px, 1fr)); gap: 12px;
         margin-top: 16px; }
.tile { background: white; border: 1px solid var(--line); border-radius: 8px; padding: 10px 14px; }
.tile b { display: block; font-size: 18px; font-weight: 600; font-variant-numeric: tabular-nums; }
.tile span { color: var(--soft); font-size: 12.5px; }
figure { margin: 0 auto; max-width: 860px; }
figure.full { max-width: none; } figure img { display: block; width: 100%; height: auto; }
figcaption { color: var(--soft); font-size: 13px; margin-top: 6px; }
.pair { display: grid; grid-template-columns: 1fr 1fr; gap: 18px; }
.pair section { margin: 0; } .pair { margin-bottom: 18px; }
@media (max-width: 900px) { .pair { grid-template-columns: 1fr; } }
.wide { overflow-x: auto; }
table { border-collapse: collapse; width: 100%; font-size: 13.5px; }
th, td { text-align: left; padding: 5px 12px 5px 0; border-bottom: 1px solid var(--line);
         vertical-align: top; }
th { color: var(--soft); font-weight: 600; }
td.number, th.number { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; }
td.best { font-weight: 700; color: var(--good); }
td.best::after { content: " ★"; font-size: 11px; }
code, pre { font: 12.5px/1.5 ui-monospace, "DejaVu Sans Mono", monospace; }
pre { background: var(--ground); padding: 12px; border-radius: 6px; overflow: auto;
      max-height: 420px; }
summary { cursor: pointer; color: var(--soft); }
footer { color: var(--soft); font-size: 12.5px; padding: 0 0 30px; }
@media print { nav { display: none; } section { break-inside: avoid; } body { background: white; } }
</style></head><body>
<header>
<h1>{{ title }}</h1>
{% for run in runs %}
<div{% if runs|length > 1 %} style="margin-top: 10px"{% endif %}>
{% if runs|length > 1 %}<b>{{ run.name }}</b> {% endif %}
<span class="badge {{ 'good' if run.converged else 'bad' }}">
{{ run.outcome or 'unknown end' }}</span>
{% if run.verdict %}<span class="badge {{ 'good' if run.reached else 'bad' }}">{{ run.verdict }}
</span>{% endif %}
<p class="meta">{{ run.meta }}</p>
{% if (run.reason or run.mend) and run.outcome[:9] != 'converged' %}
<div class="why">{% if run.reason %}<b>Why:</b> {{ run.reason }}<br>{% endif %}
{% if run.mend %}<b>What would mend it:</b> {{ run.mend }}{% endif %}</div>{% endif %}
{% for note in run.notes %}<div class="note"><b>Note:</b> {{ note }}</div>{% endfor %}
</div>
{% endfor %}
{% if tiles %}<div class="tiles">{% for tile in tiles %}
<div class="tile"><b>{{ tile.value }}</b><span>{{ tile.text }}</span></div>{% endfor %}</div>
{% endif %}
</header>
<main>
<nav>{% if comparison %}<a href="#comparison">Comparison</a>{% endif %}
{% for row in figures %}{% for f in row %}<a href="#{{ f.name }}">{{ f.title }}</a>{% endfor %}
{% endfor %}<a href="#numbers">Numbers</a><a href="#settings">Settings</a></nav>
{% if comparison %}
<section id="comparison"><h2>Comparison</h2><div class="wide"><table>
<tr><th>quantity</th>{% for run in runs %}<th class="number">{{ run.name }}</th>{% endfor %}
<th>unit</th></tr>
{% for row in comparison %}<tr><td title="{{ row.text }}">{{ row.key }}</td>
{% for cell in row.cells %}<td class="number{{ ' best' if cell.best }}">{{ cell.value }}</td>
{% endfor %}<td>{{ row.unit }}</td></tr>{% endfor %}
</table></div><p class="meta">★ best of its row, to the printed digits</p></section>
{% endif %}
{% for row in figures %}
<div{% if row|length > 1 %} class="pair"{% endif %}>{% for f in row %}
<section id="{{ f.name }}"><h2>{{ f.title }}</h2>
<figure{{ ' class=full' if row|length == 1 }}>
<img alt="{{ f.title }}" src="{{ f.data }}"><figcaption>{{ f.text }}</figcaption></figure></section>
{% endfor %}</div>
{% endfor %}
<section id="numbers"><h2>Numbers</h2>
{% for run in runs %}{% if runs|length > 1 %}<h3>{{ run.name }}</h3>{% endif %}
<div class="wide"><table><tr><th>quantity</th><th class="number">value</th><th>unit</th>
<th>what it is</th></tr>
{% for q in run.quantities %}<tr><td><code>{{ q.key }}</code></td>
<td class="{{ 'number' if q.value is number }}">{{ q.shown }}</td><td>{{ q.unit }}</td>
<td>{{ q.text }}</td></tr>{% endfor %}</table></div>{% endfor %}</section>
<section id="settings"><h2>Settings and versions</h2>
{% for run in runs %}{% if runs|length > 1 %}<h3>{{ run.name }}</h3>{% endif %}
<div class="pair"><div class="wide"><table>{% for key, value in run.settings %}
<tr><th>{{ key }}</th><td>{{ value }}</td></tr>{% endfor %}</table></div>
<div class="wide"><table>{% for key, value in run.versions %}<tr><th>{{ key }}</th>
<td><code>{{ value }}</code></td></tr>{% endfor %}</table></div></div>
{% if run.experiment %}<details><summary>The experiment, to be run again</summary>
<pre>{{ run.experiment }}</pre></details>{% endif %}{% endfor %}</section>
<footer>{{ footer }}</footer>
</main></body></html>
"""
