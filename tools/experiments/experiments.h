/* tools/experiments/experiments.h
 * The seed paper's experiments and what beats them: CSV and figures (gnuplot scripts, PNG, SVG) into a directory. What they
 * show is in tools/experiments/REPORT.md. */
#ifndef TOOLS_EXPERIMENTS_H
#define TOOLS_EXPERIMENTS_H

/** Makes the directory, prints what it does; returns an exit code. */
int experiments(const char *directory);

#endif
