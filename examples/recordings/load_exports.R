# Load exports of a recording in R, with nothing but R itself (4.1 or newer).
#
# First export the recording, for example study.xdf:
#
#     biosensor-gateway xdf export study.xdf --to csv --to edf --to kubios --to ledalab --to bids
#
# Then run this in its folder, with the recording's name without .xdf:
#
#     Rscript load_exports.R study
#
# Each part loads the same ECG; you need only the one of the format that you use. XDF itself and
# bags (MCAP) have no reader in R: export them, or see load_exports.ipynb.

arguments <- commandArgs(trailingOnly = TRUE)
name <- if (length(arguments)) arguments[1] else "study"

# The file of a folder whose name fits, the first if there are several.
one_of <- function(folder, pattern, recursive = FALSE) {
  found <- list.files(folder, pattern, full.names = TRUE, recursive = recursive)
  if (!length(found)) stop("there is no ", pattern, " in ", folder)
  sort(found)[1]
}

# CSV: a table for each stream. NaN is "no value"; seconds count from the begin of the recording.
table <- read.csv(one_of(paste0(name, "_csv"), "ecg\\.csv$"))
markers <- read.csv(file.path(paste0(name, "_csv"), "all_markers.csv"))
cat("CSV:", nrow(table), "samples\n")
print(head(table, 3))
print(markers[, c("seconds", "marker")])

# BIDS: a table without a line of names, which are in the JSON beside it.
bids_table <- function(path) {
  sidecar <- paste(readLines(sub("\\.tsv\\.gz$", ".json", path), encoding = "UTF-8"), collapse = " ")
  columns <- regmatches(sidecar, regexpr("\"Columns\": *\\[[^]]*\\]", sidecar))
  columns <- sub("^\"Columns\": *\\[(.*)\\]$", "\\1", columns)
  columns <- gsub("\"", "", trimws(strsplit(columns, ",")[[1]]))
  read.delim(gzfile(path), header = FALSE, col.names = columns, na.strings = "n/a", check.names = FALSE)
}
bids <- bids_table(one_of(paste0(name, "_bids"), "ecg_physio\\.tsv\\.gz$", recursive = TRUE))
cat("BIDS:", nrow(bids), "rows,", sum(is.na(bids$timestamp)), "of them without a sample\n")

# EDF: the gateway writes BDF+, which is EDF+ with 24 bits. The last signal is the annotations.
read_bdf <- function(path) {
  file <- file(path, "rb")
  on.exit(close(file))
  text <- function(width) {
    bytes <- readBin(file, "raw", width)
    bytes[bytes > 0x7e | bytes < 0x20] <- as.raw(0x20) # the first one is no letter
    trimws(rawToChar(bytes))
  }
  head <- vapply(c(8, 80, 80, 8, 8, 8, 44, 8, 8, 4), text, "")
  count <- as.integer(head[10])
  fields <- lapply(c(16, 80, 8, 8, 8, 8, 8, 80, 8, 32), function(width) {
    vapply(seq_len(count), function(.) text(width), "")
  })
  samples <- as.integer(fields[[9]])
  records <- as.integer(head[8])
  bytes <- matrix(as.integer(readBin(file, "raw", records * sum(samples) * 3)), nrow = 3)
  steps <- bytes[1, ] + 256 * bytes[2, ] + 65536 * bytes[3, ]
  steps <- steps - ifelse(steps >= 2^23, 2^24, 0)
  by_record <- matrix(steps, nrow = sum(samples))
  lowest <- as.numeric(fields[[4]])
  step <- (as.numeric(fields[[5]]) - lowest) / (as.numeric(fields[[7]]) - as.numeric(fields[[6]]))
  signals <- list()
  for (at in seq_len(count - 1)) {
    rows <- sum(samples[seq_len(at - 1)]) + seq_len(samples[at])
    digital <- as.vector(by_record[rows, ])
    signals[[fields[[1]][at]]] <- list(
      rate = samples[at] / as.numeric(head[9]),
      unit = fields[[3]][at],
      values = lowest[at] + (digital - as.numeric(fields[[6]][at])) * step[at]
    )
  }
  signals
}
edf <- read_bdf(one_of(paste0(name, "_edf"), "ecg.*\\.bdf$"))
cat("EDF:", length(edf[[1]]$values), "values of", names(edf)[1], "at", edf[[1]]$rate, "Hz in", edf[[1]]$unit, "\n")

# Kubios and Ledalab: texts of numbers.
kubios_files <- sort(list.files(paste0(name, "_kubios"), "ecg.*\\.txt$", full.names = TRUE))
kubios <- unlist(lapply(kubios_files, scan, quiet = TRUE))
ledalab_files <- setdiff(list.files(paste0(name, "_ledalab"), "\\.txt$"), "README.txt")
ledalab <- read.delim(
  file.path(paste0(name, "_ledalab"), ledalab_files[1]),
  header = FALSE, col.names = c("time", "conductance", "marker")
)
cat("Kubios:", length(kubios), "values; Ledalab:", nrow(ledalab), "samples\n")
print(ledalab[ledalab$marker > 0, ])

# They are the same numbers; BDF has them in 24 bits.
measured <- table[[ncol(table)]]
in_bids <- bids[[ncol(bids)]]
stopifnot(
  identical(kubios, measured),
  identical(in_bids[!is.na(in_bids)], measured[!is.na(measured)]),
  max(abs(edf[[1]]$values[seq_len(100)] - measured[seq_len(100)])) <= diff(range(measured)) / 2^23
)
cat("the same in all\n")
