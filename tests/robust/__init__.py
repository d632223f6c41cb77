"""Attacks that the project withstands, made at its public doors: files, `recon.*`, `recon VERB`.

No test here imports an inner module, so that the suite holds whatever is moved inside.

==================================  ==========================================================
attack                              here, and beside it (internals, in more detail)
==================================  ==========================================================
kills of fit, batch, convert --all  test_kills; jobs/test_writing, test_batch_killed, test_corpus
full disks                          test_disks; jobs/test_worklog, formats/test_replacing
OUT that vanished, somebody's OUT,  test_disks; jobs/test_outputs (every output of every verb)
devices
links in circles, links to inputs   test_disks; jobs/test_outputs, formats/test_replacing
odd names                           test_disks; jobs/test_corpus, test_batch
planted pickles, no eval            test_planted; formats/test_smpl_files, test_estimates, test_npz
archive and header bombs, nesting   test_planted; core/test_limits, formats/test_large_files
no network                          test_planted
locks                               test_parallel; jobs/test_worklog, test_batch
threads, fork, spawn                test_parallel; api/test_front_door, jobs/test_workers
BVH dialects, gaps, line ends,      test_producers; formats/test_bvh, test_markers,
units, rates                        test_clinic_files, ingest/test_markers
damaged files of every format       test_fuzz; formats/test_hostile
errors that say what to do          test_words
==================================  ==========================================================
"""
