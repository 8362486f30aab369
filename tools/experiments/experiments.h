/* tools/experiments/experiments.h
 * The experiments of the paper, and the gateway's methods in comparison: CSV and figures (gnuplot scripts, PNG, SVG).
 * The results are discussed in tools/experiments/REPORT.md. */
#ifndef TOOLS_EXPERIMENTS_EXPERIMENTS_H
#define TOOLS_EXPERIMENTS_EXPERIMENTS_H

/** Creates the directory and prints the progress. Returns an exit code of cli.h. */
int experiments(const char *directory);

#endif
