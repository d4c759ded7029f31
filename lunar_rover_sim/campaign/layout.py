"""Names in the folder of a data set.

    README.md, card.json      the data card
    episodes.csv              the episodes as a table
    croissant.json            all of it in the vocabulary of MLCommons
    campaign.json             the campaign that it comes from
    episodes/0007/            bag, scenario.yaml, rover.yaml, exported formats, manifest.json
    failed/0008/              error.json, logs: episodes that could not be made
    partial/                  what is being made, or was when the machine stopped
"""

EPISODES = 'episodes'
FAILED = 'failed'
PARTIAL = 'partial'
CAMPAIGN_FILE = 'campaign.json'
CARD_FILE = 'card.json'
README_FILE = 'README.md'
EPISODE_TABLE = 'episodes.csv'
CROISSANT_FILE = 'croissant.json'
ERROR_FILE = 'error.json'
LOG_FILE = 'campaign.log'
PLAN_FILE = 'planned.yaml'
TASK_FILE = 'task.json'
TOKEN_FILE = '.token'
LOCK_FILE = '.lock'
STOP_FILE = '.stop'
